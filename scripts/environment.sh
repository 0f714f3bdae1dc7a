# Sourced by scripts/demo and scripts/test: makes the project's own virtual environment (.venv) from the lock file in
# $LOCK (requirements.lock unless set) and leaves its python in $PYTHON. Run again only when the lock or the project file
# changes; what the demo has installed, the tests add to, and the demo leaves out nothing that the tests had.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"
PYTHON="$root/.venv/bin/python"
stamp="$root/.venv/installed"

install_venv_module() {  # Debian ships python3 without ensurepip; the package python3-venv adds it
    echo "python3 has no ensurepip: installing Debian's python3-venv" >&2
    local sudo=()
    [ "$(id -u)" = 0 ] || sudo=(sudo -n)
    if ! { "${sudo[@]}" apt-get update -qq && "${sudo[@]}" apt-get install -y -qq python3-venv; } >&2; then
        echo "Could not install it; run 'apt-get install python3-venv' as root, then try again." >&2
        exit 1
    fi
}

install_locked() {  # pip tells nothing or too much: show how many packages of how many it has come to
    local total
    total=$(grep -o '^[a-zA-Z0-9_.-]*==' "$lock" | sort -u | wc -l)
    "$PYTHON" -m pip install --disable-pip-version-check --progress-bar off --no-compile --require-hashes -r "$lock" \
        | awk -v total="$total" -v shown="$([ -t 2 ] && echo yes)" '
            /^Collecting/ { count++; if (shown) printf "\r\033[K  %d of at most %d: %s", count, total, $2 }
            /^Installing/ { if (shown) printf "\r\033[K"; printf "  installing %d packages ...\n", count }' >&2
    "$PYTHON" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    # pip would compile on one core, for half of its time; what is no Python of this version, as templates are, stays.
    "$PYTHON" -m compileall -qq -j 0 .venv/lib || true
}

PATH=${PATH//"$root/.venv/bin:"/}  # an activated .venv must not be asked to make itself anew
lock=${LOCK:-requirements.lock}
installed=$(cat "$stamp" 2>/dev/null || true)
if [[ $installed == *" requirements.lock"* ]]; then lock=requirements.lock; fi
wanted=$(sha256sum "$lock" pyproject.toml)
if [ "$installed" != "$wanted" ]; then
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or later is needed." >&2; exit 1; }
    python3 -c 'import ensurepip' 2>/dev/null || install_venv_module
    echo "Setting up .venv from $lock (once; a few minutes) ..." >&2
    if [ "$installed" != "$(sha256sum requirements-demo.lock pyproject.toml)" ]; then
        rm -rf .venv
        python3 -m venv .venv
    fi
    install_locked
    "$PYTHON" -m ronnaplan prepare
    echo "$wanted" > "$stamp"
fi
export PATH="$root/.venv/bin:$PATH"
