# Builds and enters a Debian 12 armhf userland: the robot's Python packages on an emulated 32-bit ARM. Sourced by tools/test-armhf
# after lib.sh. Sets and uses $userland, $suite and $userland_packages; functions that enter it need mount_userland first.

userland=${MIP_RT_ARMHF_ROOT:-${XDG_CACHE_HOME:-$HOME/.cache}/mip-rt-armhf}
suite=bookworm
plugin_folder=/opt/mip-rt-counting
userland_packages="python3-numba python3-numpy python3-smbus2 python3-yaml python3-serial python3-pytest python3-hypothesis"
# Numba's LLVM aborts on a 32-bit ARM processor that it does not know, as the emulated one; the BeagleBone's is a Cortex-A8.
# A fixed hash seed makes two counted runs comparable.
userland_settings=(NUMBA_CPU_NAME=cortex-a8 PYTHONHASHSEED=0 HOME=/root PATH=/usr/bin:/bin LANG=C.UTF-8)

# debian_mirror: prints the address that this machine takes Debian's packages from, out of its apt sources.
debian_mirror() {
  local mirror=${MIP_RT_DEBIAN_MIRROR:-}
  [ -n "$mirror" ] || mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Label: Debian' 2>/dev/null | sort -u | head -n 1)
  # Debian's cloud images name a file that lists mirrors.
  case $mirror in mirror+file:*) mirror=$(grep -m 1 -Eo '^https?:[^[:space:]]+' "${mirror#mirror+file:}") || true ;; esac
  [ -n "$mirror" ] || fail "no Debian mirror in this machine's apt sources ($(machine_name)); cure: MIP_RT_DEBIAN_MIRROR=address $script"
  printf '%s' "${mirror%/}"
}

# enable_emulation: lets this kernel start 32-bit ARM programs through QEMU.
enable_emulation() {
  local entry=/proc/sys/fs/binfmt_misc/qemu-arm
  [ -e /proc/sys/fs/binfmt_misc/status ] || mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc ||
    fail "the kernel cannot register program formats (binfmt_misc), which emulation needs"
  [ -e $entry ] || quietly "update-binfmts" update-binfmts --enable qemu-arm || true
  [ -e $entry ] || fail "qemu-arm is not registered with the kernel; cure: apt-get install --reinstall qemu-user-static binfmt-support"
}

# mount_userland: what programs inside expect. The caller is in its own mount namespace, so nothing stays mounted.
mount_userland() {
  mountpoint -q "$userland/proc" || mount -t proc proc "$userland/proc"
  mountpoint -q "$userland/dev" || mount --rbind /dev "$userland/dev"
}

# inside COMMAND...: runs it in the userland, in the copy of the checkout.
inside() { chroot "$userland" /usr/bin/env -i -C /mip-rt "${userland_settings[@]}" "$@"; }

# bootstrap_userland: a minimal Debian for 32-bit ARM, where there is none yet. About 3 minutes.
bootstrap_userland() {
  local mirror
  if [ -x "$userland/usr/bin/dpkg-query" ] && [ ! -d "$userland/debootstrap" ]; then return; fi
  mirror=$(debian_mirror)
  say "building a Debian armhf userland ($suite) in $userland (about 5 minutes, 1 GB)"
  # A build that was cut short cannot be continued. Nothing is mounted there: this namespace is new.
  rm -rf --one-file-system "$userland"
  mkdir -p "$userland"
  quietly "debootstrap, stage 1" debootstrap --arch=armhf --variant=minbase --foreign $suite "$userland" "$mirror" || fail "no userland"
  cp "$(command -v qemu-arm-static)" "$userland/usr/bin/"
  mkdir -p "$userland/etc/apt/apt.conf.d" "$userland/etc/ssl/certs"
  quietly "debootstrap, stage 2" chroot "$userland" /debootstrap/debootstrap --second-stage || fail "no userland"
  echo "deb $mirror $suite main" >"$userland/etc/apt/sources.list"
  # How this machine reaches the mirror (proxies, checks) holds inside too.
  apt-config dump | grep -E '^Acquire::(http|https|Check|Retries)' >"$userland/etc/apt/apt.conf.d/90mip-rt" || true
}

# build_userland: with the packages that it needs. Some minutes the first time, a second later.
build_userland() {
  local package packages missing=() started=$SECONDS
  bootstrap_userland
  mkdir -p "$userland/mip-rt"
  mount_userland
  packages=$(inside dpkg-query --show --showformat '${Package} ${db:Status-Status}\n')
  for package in $userland_packages; do
    grep -qx "$package installed" <<<"$packages" || missing+=("$package")
  done
  [ ${#missing[@]} != 0 ] || return 0
  say "installing in the userland: ${missing[*]}"
  cp -L /etc/resolv.conf "$userland/etc/resolv.conf"
  quietly "apt-get in the userland" inside sh -c 'export DEBIAN_FRONTEND=noninteractive
    for attempt in 1 2 3; do
      apt-get -qq update && apt-get -qq install --yes --no-install-recommends "$@" && exit 0
      sleep 10
    done
    exit 1' sh "${missing[@]}" || fail "the userland is not complete; run $script again when the network works"
  say "userland ready after $((SECONDS - started)) s"
}

# copy_checkout: puts the files of the checkout that git tracks or would track into the userland, without those of an earlier copy.
copy_checkout() {
  rm -rf --one-file-system "$userland/mip-rt"
  mkdir -p "$userland/mip-rt"
  (
    cd "$checkout"
    if [ -e .git ] && command -v git >/dev/null; then
      git -c safe.directory="$checkout" ls-files --cached --others --exclude-standard -z |
        while IFS= read -r -d '' file; do [ ! -e "$file" ] || printf '%s\0' "$file"; done |
        tar --null --files-from=- -cf -
    else
      tar --exclude=./.venv --exclude=./.git --exclude=__pycache__ -cf - .
    fi
  ) | tar -xf - -C "$userland/mip-rt"
}

# prepare_counting: compiles the plug-in and brings the emulator that can load it, with its libraries, into the userland.
prepare_counting() {
  local folder=$userland$plugin_folder emulator api library
  emulator=$(command -v qemu-arm)
  mkdir -p "$folder"
  for library in $(ldd "$emulator" | grep -Eo '/[^ ]+'); do cp -L "$library" "$folder/"; done
  cp "$emulator" "$folder/qemu-arm"
  # QEMU refuses a plug-in made for another version of its interface, and does not tell its own.
  for api in 1 2 3 4 5; do
    quietly "compiling the plug-in" gcc -O2 -Wall -Wextra -shared -fPIC -DPLUGIN_API=$api \
      -o "$folder/count_instructions.so" "$checkout/tools/armhf/count_instructions.c" || return
    ! counted /bin/true >/dev/null 2>&1 || return 0
  done
  say "$(qemu-arm --version | head -n 1) does not load the plug-in"
  return 1
}

# counting PROGRAM ARGUMENT...: runs the emulated program (an absolute path) with the plug-in, which writes counts to standard error.
counting() {
  inside $plugin_folder/ld-linux-x86-64.so.2 --library-path $plugin_folder $plugin_folder/qemu-arm \
    -plugin $plugin_folder/count_instructions.so "$@" </dev/null
}

# counted PROGRAM ARGUMENT...: runs the emulated program (an absolute path) and prints how many instructions it took.
counted() {
  local errors code=0 count
  errors=$(mktemp)
  counting "$@" >&2 2>"$errors" || code=$?
  count=$(sed -n 's/^instructions: //p' "$errors" | tail -n 1)
  { [ $code = 0 ] && [ -n "$count" ]; } || { tail -n 15 "$errors" >&2; rm -f "$errors"; return 1; }
  rm -f "$errors"
  printf '%s\n' "$count"
}
