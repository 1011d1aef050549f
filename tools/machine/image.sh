# Builds the emulated machine: a Debian 12 armhf system with kernel and systemd, as a disk image that QEMU boots. Sourced by
# tools/test-machine after lib.sh and armhf/userland.sh, whose functions build the system as a folder first.

machine=${MIP_RT_MACHINE_ROOT:-${XDG_CACHE_HOME:-$HOME/.cache}/mip-rt-machine}
userland=$machine/system
# A BeagleBoard image has these, too, but for the large Python packages: unpacking them on the emulated machine would only cost time.
userland_packages="systemd-sysv udev dbus kmod procps linux-image-armmp initramfs-tools e2fsprogs python3-numba python3-numpy python3-smbus2 \
python3-yaml python3-serial"
# What tools/install has to install itself there; without network, from apt's archive of downloaded packages.
left_to_install="python3-venv python3-setuptools python3-wheel device-tree-compiler cpp"

# build_system: the folder $userland, with kernel and initial RAM disk beside it. About 10 minutes the first time.
build_system() {
  local folder=$userland/etc/initramfs-tools
  bootstrap_userland
  # No daemon of the new system may start on this machine while its packages are configured; and its initial RAM disk holds only
  # what QEMU's disk needs, because collecting all modules takes an emulated processor many minutes.
  mkdir -p "$folder/conf.d" "$folder/hooks"
  printf '#!/bin/sh\nexit 101\n' >"$userland/usr/sbin/policy-rc.d"
  echo MODULES=list >"$folder/conf.d/machine"
  printf '#!/bin/sh\n[ "$1" = prereqs ] || { . /usr/share/initramfs-tools/hook-functions; force_load virtio_mmio; force_load virtio_blk; force_load ext4; }\n' \
    >"$folder/hooks/machine"
  chmod 755 "$userland/usr/sbin/policy-rc.d" "$folder/hooks/machine"
  build_userland
  if [ ! -e "$machine/initrd.img" ]; then
    inside apt-get clean
    # shellcheck disable=SC2086  # a list of words
    quietly "downloading for the emulated machine" inside sh -c 'apt-get -qq update && apt-get -qq --download-only --yes --no-install-recommends install "$@"' \
      sh $left_to_install || fail "the packages that tools/install needs cannot be downloaded"
    cp "$(ls "$userland"/boot/vmlinuz-* | tail -n 1)" "$machine/vmlinuz"
    cp "$(ls "$userland"/boot/initrd.img-* | tail -n 1)" "$machine/initrd.img"
  fi
}

# build_disk FOLDER IMAGE SIZE LABEL: a file system with the folder's content; the file takes only the space of what is written.
build_disk() {
  rm -f "$2"
  truncate -s "$3" "$2"
  quietly "mke2fs" mke2fs -q -t ext4 -L "$4" -d "$1" "$2"
}

# build_machine: the disk that every run starts from.
build_machine() {
  [ ! -e "$machine/system.img" ] || return 0
  say "building the emulated machine's disk"
  rm -rf --one-file-system "$userland/mip-rt"
  printf 'LABEL=system / ext4 defaults,noatime 0 1\nLABEL=given /given ext4 ro 0 0\n' >"$userland/etc/fstab"
  echo robot >"$userland/etc/hostname"
  mkdir -p "$userland/given" "$userland/boot"
  cp "$checkout/tools/machine/uEnv.txt" "$userland/boot/uEnv.txt"
  cp "$checkout/tools/machine/machine-checks.service" "$userland/etc/systemd/system/"
  ln -sf ../machine-checks.service "$userland/etc/systemd/system/multi-user.target.wants/machine-checks.service"
  # The console carries the checks' words; storing the journal shows what a restart leaves.
  ln -sf /dev/null "$userland/etc/systemd/system/serial-getty@ttyAMA0.service"
  mkdir -p "$userland/var/log/journal"
  umount -R "$userland/dev" "$userland/proc"
  build_disk "$userland" "$machine/system.img.new" 2900M system || fail "no disk"
  debugfs -w -R 'rm /usr/sbin/policy-rc.d' "$machine/system.img.new" 2>/dev/null
  mv "$machine/system.img.new" "$machine/system.img"
}
