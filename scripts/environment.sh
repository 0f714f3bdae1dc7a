# Sourced by scripts/demo and scripts/test: makes the project's own virtual environment (.venv) from requirements.lock
# and leaves its python in $PYTHON. Run again only when the lock or the project file changes.
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

if [ "$(cat "$stamp" 2>/dev/null)" != "$(sha256sum requirements.lock pyproject.toml)" ]; then
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or later is needed." >&2; exit 1; }
    python3 -c 'import ensurepip' 2>/dev/null || install_venv_module
    echo "Setting up .venv (once; a few minutes) ..." >&2
    rm -rf .venv
    python3 -m venv .venv
    "$PYTHON" -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
    "$PYTHON" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    sha256sum requirements.lock pyproject.toml > "$stamp"
fi
export PATH="$root/.venv/bin:$PATH"
