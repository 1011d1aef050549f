# What the scripts in tools/ share: messages, Debian packages, the project's Python environment. Sourced, not run.
# Everything here speaks on standard error: standard output belongs to the program that is run in the end (mip-rt --json).

checkout=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
environment=$checkout/.venv
stamp=$environment/mip-rt-ready
script=tools/${0##*/}

# A workspace that is sourced in the user's shell (ROS, for one) would put other versions of our packages in front of ours.
unset PYTHONPATH PYTHONHOME

say() { printf '%s: %s\n' "$script" "$*" >&2; }
fail() { say "$*"; exit 1; }

# What machine this is.
on_debian_12() { ( . /etc/os-release 2>/dev/null && [ "${ID:-}" = debian ] && [ "${VERSION_ID:-}" = 12 ] ); }
on_ubuntu_22_04() { ( . /etc/os-release 2>/dev/null && [ "${ID:-}" = ubuntu ] && [ "${VERSION_ID:-}" = 22.04 ] ); }
on_32_bit_arm() { case $(uname -m) in armv6l|armv7l) true ;; *) false ;; esac; }
machine_name() { ( . /etc/os-release 2>/dev/null && printf '%s' "${PRETTY_NAME:-}" ) || uname -s; }

# quietly LABEL COMMAND...: runs it with its output kept; shows the end of that output when it fails.
quietly() {
  local label=$1 log code=0; shift
  log=$(mktemp)
  "$@" >"$log" 2>&1 </dev/null || code=$?
  [ $code = 0 ] || { say "$label failed; the end of its output:"; tail -n 25 "$log" >&2; }
  rm -f "$log"
  return $code
}

# install_packages REASON PACKAGE...: by apt-get, as root or through a sudo that asks nothing; else prints the cure and exits.
install_packages() {
  local reason=$1 as_root=() attempt; shift
  command -v apt-get >/dev/null || fail "$reason; here is no apt-get: install the equivalent of $* and run $script again"
  if [ "$(id -u)" != 0 ]; then
    sudo -n true 2>/dev/null || fail "$reason; cure: sudo apt-get update && sudo apt-get install $*"
    as_root=(sudo -n)
  fi
  say "$reason: installing $*"
  for attempt in 1 2 3; do
    # A source that cannot be reached must not matter where the others have the packages.
    "${as_root[@]}" apt-get -qq update </dev/null >/dev/null 2>&1 || true
    quietly "apt-get install $*" "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=600 \
      install --yes --no-install-recommends "$@" && return
    [ $attempt = 3 ] || sleep 5
  done
  fail "$reason; cure: make 'apt-get update && apt-get install $*' work on this machine, then run $script again"
}

# find_python: prints a Python >= 3.11; the system's own first, then newer ones beside it.
find_python() {
  local candidate
  for candidate in ${MIP_RT_PYTHON:-python3 python3.14 python3.13 python3.12 python3.11}; do
    "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { command -v "$candidate"; return; }
  done
  return 1
}

# require_python: sets $python to one that can make environments, by installing what Debian and Ubuntu leave out.
require_python() {
  local wanted version
  if ! python=$(find_python); then
    [ -z "${MIP_RT_PYTHON:-}" ] || fail "MIP_RT_PYTHON=$MIP_RT_PYTHON is not a Python >= 3.11"
    wanted="python3 python3-venv"
    if command -v python3 >/dev/null; then
      # Of the systems whose python3 is older, Ubuntu 22.04 (3.10) has python3.11 beside it.
      on_ubuntu_22_04 || fail "mip-rt needs Python 3.11 or newer and $(machine_name) has $(python3 --version); Debian 12, Ubuntu 24.04 \
and newer have it (or name one: MIP_RT_PYTHON=/path/to/python $script)"
      wanted="python3.11 python3.11-venv"
    fi
    install_packages "mip-rt needs Python 3.11 or newer, which is not here" $wanted
    python=$(find_python) || fail "$(machine_name) has no Python 3.11 or newer; Debian 12, Ubuntu 24.04 and newer have"
  fi
  if ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
    version=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
    install_packages "$python cannot make environments" "$version-venv"
    "$python" -c 'import venv, ensurepip' 2>/dev/null || fail "$python still cannot make environments (no venv or ensurepip)"
  fi
}

# What the environment was made for: it holds absolute paths, and the interpreter of one minor version.
base_identity() { printf '%s %s' "$checkout" "$(readlink -f "$environment/bin/python")"; }
content_identity() { sha256sum <"$checkout/pyproject.toml"; }

# environment_ready LEVEL: whether .venv serves LEVEL (run, or test, which includes run). Needs no network and some milliseconds.
environment_ready() {
  local base='' content='' level=''
  [ -x "$environment/bin/python" ] && [ -r "$stamp" ] || return 1
  { read -r base; read -r content; read -r level; } <"$stamp" || true
  [ "$base" = "$(base_identity)" ] && [ "$content" = "$(content_identity)" ] && { [ "$level" = test ] || [ "$level" = "$1" ]; }
}

# ensure_environment LEVEL: makes .venv or brings it up to date. Several at a time wait for the first.
ensure_environment() {
  environment_ready "$1" && return
  [ "$(uname -s)" = Linux ] || fail "mip-rt runs on Linux; this is $(uname -s)"
  [ -w "$checkout" ] || fail "$checkout cannot be written by $(id -un), and .venv has to be made there"
  (
    flock --nonblock 9 || { say "waiting for another set-up of $environment"; flock 9; }
    environment_ready "$1" || make_environment "$1"
  ) 9>"$checkout/.venv.lock"
}

make_environment() {
  local level=$1 base='' extras='' started=$SECONDS
  [ ! -r "$stamp" ] || read -r base <"$stamp"
  if [ -z "$base" ] || [ "$base" != "$(base_identity)" ]; then
    # No stamp: a set-up that was interrupted. Another identity: the checkout was moved or the system's Python changed.
    rm -rf "$environment"
    require_python
    say "making $environment with $("$python" --version)"
    quietly "$python -m venv" "$python" -m venv "$environment" || fail "cannot make $environment"
  else
    ! grep -qx test "$stamp" || level=test
    say "bringing $environment up to date"
    rm -f "$stamp"
  fi
  [ "$level" = run ] || extras='[lab,view,test]'
  say "installing mip-rt$extras and what it needs (about a minute)"
  quietly "pip install" env -C "$checkout" "$environment/bin/python" -m pip install --no-input --disable-pip-version-check -e ".$extras" ||
    fail "the environment is not ready; the network is needed for this step only: run $script again when it works"
  printf '%s\n%s\n%s\n' "$(base_identity)" "$(content_identity)" "$level" >"$stamp"
  say "ready after $((SECONDS - started)) s"
}

# The packages of Debian 12, which are what the robot runs. system_python is the interpreter that has them.
system_python=/usr/bin/python3
core_packages=(python3 python3-numba python3-numpy python3-smbus2 python3-yaml python3-serial)
# What puts the program into an environment of its own, without network.
environment_packages=(python3-venv python3-setuptools python3-wheel)
test_packages=("${core_packages[@]}" "${environment_packages[@]}" python3-pytest python3-hypothesis python3-matplotlib python3-scipy python3-plotly)

# ensure_packages REASON PACKAGE...: installs those that are missing.
ensure_packages() {
  local reason=$1 missing=() package; shift
  for package; do
    [ "$(dpkg-query --show --showformat '${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
  done
  [ ${#missing[@]} = 0 ] || install_packages "$reason" "${missing[@]}"
}
