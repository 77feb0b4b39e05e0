# What the scripts here share; bash. Source it.
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)

say() { printf '%s\n' "ci: $*"; }
fail() { printf '%s\n' "ci: $*" >&2; exit 2; }

# Makes the environment a bare one, installs system packages where they are missing.
prepare_system() {
    # A shell that has ROS or another environment loaded must not lend it to the tests.
    unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME
    unset PYTHONPATH VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE
    # Tests talk over DDS; they must not reach other machines.
    export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST

    local missing=()
    command -v python3 >/dev/null || missing+=(python3)
    command -v g++ >/dev/null || missing+=(g++)
    python3 -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv)
    python3 - 2>/dev/null <<'PYTHON' || missing+=(python3-dev)
import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))
PYTHON
    if [ "${#missing[@]}" -gt 0 ]; then
        command -v apt-get >/dev/null ||
            fail "missing: ${missing[*]} (names of Debian and Ubuntu); install them"
        local sudo=()
        [ "$(id -u)" -eq 0 ] || sudo=(sudo)
        say "installing ${missing[*]}"
        "${sudo[@]}" apt-get update -qq
        "${sudo[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}"
    fi
    prepare_browser
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 10))' ||
        fail "$(command -v python3) is $(python3 --version), expected 3.10 or newer; put a newer python3 on PATH"
}

# Installs the browser that the report is tested in; where there is none, these tests are skipped.
prepare_browser() {
    command -v chromedriver >/dev/null && return
    command -v apt-get >/dev/null || { say "no chromedriver: no tests in a browser"; return; }
    local sudo=()
    [ "$(id -u)" -eq 0 ] || sudo=(sudo)
    say "installing chromium chromium-driver"
    { "${sudo[@]}" apt-get update -qq &&
        "${sudo[@]}" apt-get install -y -qq --no-install-recommends chromium chromium-driver; } ||
        say "chromium cannot be installed: no tests in a browser"
}

# Copies what git would commit, tracked files and new ones that are not ignored, to $work.
copy_tree() {
    work=$(mktemp -d "${TMPDIR:-/tmp}/pipeline_tracker-ci.XXXXXX")
    trap 'rm -rf -- "$work"' EXIT
    if git -C "$root" rev-parse --git-dir >/dev/null 2>&1; then
        revision=$(git -C "$root" describe --always --dirty 2>/dev/null || echo "no commit")
        # A file that git lists may have been deleted since.
        (cd "$root" && git ls-files -z --cached --others --exclude-standard |
            while IFS= read -r -d '' file; do
                if [ -e "$file" ]; then printf '%s\0' "$file"; fi
            done | tar --null --files-from=- -cf -) | tar -xf - -C "$work"
    else
        revision="not from git"
        tar -C "$root" --exclude=./.venv --exclude=./build --exclude=./install --exclude=./log \
            -cf - . | tar -xf - -C "$work"
    fi
}

say_where() {
    say "revision:    $revision"
    say "system:      $(uname -srm), $(nproc) cores"
    say "python3:     $(python3 --version) at $(command -v python3)"
    say "compiler:    $(g++ --version | head -n 1)"
    say "directory:   $work"
}
