/* A plug-in for QEMU's user-mode emulator that counts the instructions of the emulated program.

   QEMU translates straight-line pieces of code ("blocks") and runs each many times. When a block is translated we learn how many
   instructions it has; each time it runs we add that number. At the end the sum is printed on standard error as
       instructions: N
   by the process that was started, not by children that it forks (their sums include what they inherited). The sum so far is printed
   likewise whenever that process asks for the process group MARK, which nobody has: so a program can have its parts counted.

   The declarations below are the part of qemu-plugin.h used here, so that no QEMU sources are needed. Build with
   -DPLUGIN_API=N for the interface version that the installed QEMU accepts (1 for 7.2; tools/test-armhf finds it by trying). */
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <unistd.h>

struct qemu_plugin_tb;
enum { CALLBACK_READS_NO_REGISTERS = 0 };
enum { SYSTEM_CALL_GETPGID = 132, MARK = 0x6d697072 }; /* 32-bit ARM; mip_rt.lab.choices.MARK */
void qemu_plugin_register_vcpu_tb_trans_cb(uint64_t id, void (*callback)(uint64_t id, struct qemu_plugin_tb *block));
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *block, void (*callback)(unsigned cpu, void *data),
                                          int flags, void *data);
void qemu_plugin_register_atexit_cb(uint64_t id, void (*callback)(uint64_t id, void *data), void *data);
void qemu_plugin_register_vcpu_syscall_cb(uint64_t id, void (*callback)(uint64_t id, unsigned cpu, int64_t number, uint64_t a1,
                                          uint64_t a2, uint64_t a3, uint64_t a4, uint64_t a5, uint64_t a6, uint64_t a7, uint64_t a8));
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *block);

__attribute__((visibility("default"))) int qemu_plugin_version = PLUGIN_API;

static uint64_t instructions;
static pid_t counted_process;

static void block_runs(unsigned cpu, void *length)
{
    (void)cpu;
    __atomic_fetch_add(&instructions, (uint64_t)(uintptr_t)length, __ATOMIC_RELAXED);
}

static void block_translated(uint64_t id, struct qemu_plugin_tb *block)
{
    (void)id;
    void *length = (void *)(uintptr_t)qemu_plugin_tb_n_insns(block);
    qemu_plugin_register_vcpu_tb_exec_cb(block, block_runs, CALLBACK_READS_NO_REGISTERS, length);
}

static void print_sum(void)
{
    if (getpid() == counted_process)
        fprintf(stderr, "instructions: %" PRIu64 "\n", instructions);
}

static void system_call(uint64_t id, unsigned cpu, int64_t number, uint64_t a1, uint64_t a2, uint64_t a3, uint64_t a4, uint64_t a5,
                        uint64_t a6, uint64_t a7, uint64_t a8)
{
    (void)id, (void)cpu, (void)a2, (void)a3, (void)a4, (void)a5, (void)a6, (void)a7, (void)a8;
    if (number == SYSTEM_CALL_GETPGID && (uint32_t)a1 == MARK)
        print_sum();
}

static void at_exit(uint64_t id, void *data)
{
    (void)id, (void)data;
    print_sum();
}

__attribute__((visibility("default"))) int qemu_plugin_install(uint64_t id, const void *info, int argc, char **argv)
{
    (void)info, (void)argc, (void)argv;
    counted_process = getpid();
    qemu_plugin_register_vcpu_tb_trans_cb(id, block_translated);
    qemu_plugin_register_vcpu_syscall_cb(id, system_call);
    qemu_plugin_register_atexit_cb(id, at_exit, NULL);
    return 0;
}
