# shellcheck shell=bash
# Sourced by scripts/demo and scripts/test: where the checkout is, and the virtual environment in it.

unset PYTHONPATH PYTHONHOME # they would shadow the pinned versions
unset PYTHONDONTWRITEBYTECODE # every process would compile every module again
checkout="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"

# Prints a Python of at least 3.11 that can make environments: $PYTHON where that is set.
find_python() {
  local check='import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))'
  if [ -n "${PYTHON:-}" ]; then
    set -- "$PYTHON"
  else
    set -- python3.11 python3.12 python3
  fi
  local candidate
  for candidate in "$@"; do
    if "$candidate" -c "$check" >/dev/null 2>&1; then
      echo "$candidate"
      return
    fi
  done
  echo "torchlight: $* is missing, older than 3.11 or without the venv module:" \
    "install Python 3.11 with venv, or name one with PYTHON=/path/to/python3.11" >&2
  return 1
}

# Prints what an environment is made of: where it lies, its Python and the pinned versions.
foundation() {
  pwd
  "${PYTHON:-.venv/bin/python}" --version 2>/dev/null || true
  cat scripts/constraints.txt
}

install() {
  .venv/bin/python -m pip install -q --disable-pip-version-check --no-input --no-compile -c scripts/constraints.txt "$@"
}

# Makes .venv, or brings it up to date, with the package and the extras named ($1: nothing or "test"). Where the
# foundation changed, an environment made here before is made anew; a changed pyproject.toml is installed over it.
make_environment() (
  cd "$checkout"
  made=.venv/torchlight-made.txt
  installed=".venv/torchlight-installed-${1:-base}.txt"
  if [ "$(cat "$installed" 2>/dev/null)" = "$(foundation; cat pyproject.toml)" ]; then
    return
  fi
  python="$(find_python)"
  echo "torchlight: setting up $checkout/.venv; the first time takes a few minutes" >&2
  if [ -e "$made" ] && [ "$(cat "$made")" != "$(foundation)" ]; then
    "$python" -m venv --clear .venv
  else
    "$python" -m venv .venv
  fi
  foundation >"$made"
  rm -f "$installed"
  install torch # first and alone: by far the largest download fails before anything else does
  install -e ".${1:+[$1]}"
  .venv/bin/python -m compileall -q -j 0 .venv/lib >/dev/null || true # pip would on one processor; some are templates
  { foundation; cat pyproject.toml; } >"$installed"
)
