# What the commands of this folder share: where things are, dependencies, build. Sourced, not run.

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
# catkin breaks with another python3 in front of Debian's.
export PATH="/usr/bin:/bin:/usr/sbin:/sbin:$PATH"

say() { printf '%s\n' "$*"; }
fail() { printf 'error: %s\n' "$*" >&2; exit 1; }

# Installs the packages of debian_packages.txt that are missing.
install_dependencies() {
  # shellcheck disable=SC2046
  install_packages "building and running need (reasons: scripts/debian_packages.txt)" \
    $(sed -e 's/#.*//' -e 's/[[:space:]].*//' "$root/scripts/debian_packages.txt" | grep .)
}

# Installs those of some packages that are missing. The first argument says in words what they are for.
install_packages() {
  command -v dpkg-query >/dev/null || fail "this needs Debian 12, or another system of CONTRIBUTING.md that has its packages: dpkg-query is not there"
  local needed_by="$1" missing=() package
  shift
  for package in "$@"; do
    [ "$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
  done
  [ ${#missing[@]} -gt 0 ] || return 0

  say "Installing ${#missing[@]} Debian packages that $needed_by:"
  say "  ${missing[*]}"
  local as_root=()
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || fail "packages are missing and only root can install them; as root: apt-get install ${missing[*]}"
    as_root=(sudo)
  fi
  local log
  log=$(mktemp)
  "${as_root[@]}" apt-get update >"$log" 2>&1 ||
    fail "apt-get update failed (no network, or no right to install): $(tail -n 1 "$log")"
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "${missing[@]}" \
    >"$log" 2>&1 || fail "apt-get install failed: $(grep -E '^E:' "$log" | head -n 3 | tr '\n' ' ') (log: $log)"
  rm -f "$log"
}

# Of a build's output, what a person waiting for it wants to see.
show_build() { grep --line-buffered -E 'warning:|error:|Error|Linking CXX (shared|executable)' | sed -u 's/^/  /' || true; }

# Where it is built. Another kind of build than the usual one has folders of its own.
build="$root/build"
devel="$root/devel"
use_build() {
  build="$root/build_$1"
  devel="$root/devel_$1"
}

# catkin_make in these folders.
make_workspace() { (cd "$root" && catkin_make --build "$build" -DCATKIN_DEVEL_PREFIX="$devel" "$@"); }

# Builds the workspace in Release; further arguments go to catkin_make. Shows the compiler's warnings and the progress.
build_workspace() {
  local log="$build/build.log"
  mkdir -p "$build"
  say "Building (log: $log) ..."
  if ! make_workspace -DCMAKE_BUILD_TYPE=Release -DCMAKE_EXPORT_COMPILE_COMMANDS=ON "$@" 2>&1 | tee "$log" | show_build; then
    fail "the build failed; see $log"
  fi
}

# Sets `flags`, arguments of build_workspace for a build with the compiler's sanitizers: with the assertions of Eigen and
# of the standard library, and without kernels for several processors, which are picked before a sanitizer is ready.
# Further arguments are compiler flags.
sanitizer_flags() {
  local sanitizers="-fsanitize=$1"
  case ",$1," in
    # Without what the address sanitizer finds, too: half the time to build.
    *,address,*undefined,*) sanitizers+=" -fno-sanitize=null,alignment,object-size,vptr" ;;
  esac
  flags=("-DCMAKE_CXX_FLAGS_RELEASE=-O1 -g1 -fno-omit-frame-pointer -D_GLIBCXX_ASSERTIONS -DXRAY_TRACKING_PLAIN_KERNELS $sanitizers ${*:2}")
}

# Makes the workspace's packages known to this shell.
source_workspace() {
  set +u
  # shellcheck disable=SC1091
  . "$devel/setup.bash"
  set -u
}

# A master of one's own on the loopback: runs neither meet each other nor leave the machine.
use_private_master() {
  # By its name: with 127.0.0.1 C++ nodes would send and receive on all interfaces.
  export ROS_HOSTNAME=localhost
  unset ROS_IP
  ROS_MASTER_URI="http://127.0.0.1:$(/usr/bin/python3 -c '
import socket
s = socket.socket()
s.bind(("127.0.0.1", 0))
print(s.getsockname()[1])')"
  export ROS_MASTER_URI
}
