#!/bin/sh
# Installs what KIT1000 runs on into an environment: install.sh PYTHON
#
# Where pybullet has no wheel it is compiled, and a line every minute tells so: pip is silent meanwhile.
set -u
python=$1
pip="-m pip --disable-pip-version-check --quiet"
started=$(date +%s)

has_wheel() {
    [ "$(uname -sm)" = "Linux x86_64" ] || return 1
    "$python" -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 10), (3, 11)))'
}

ticking() {
    while sleep "${MINUTE:-60}"; do
        echo "still compiling pybullet: $(( ($(date +%s) - started) / 60 )) min" >&2
    done
}

if ! has_wheel && ! "$python" -c 'import pybullet' 2>/dev/null >&2; then
    echo "compiling pybullet, which has no wheel here: about 6 minutes (none with Python 3.11 on x86-64 Linux)" >&2
    ticking </dev/null >/dev/null &
    ticker=$!
    trap 'kill $ticker 2>/dev/null' EXIT
    trap 'exit 130' INT TERM
fi
# Python compiles a module at its first import: compiling all of them takes as long as installing them.
"$python" $pip install --no-compile --require-hashes -r requirements/run.txt || exit 1
"$python" $pip install --no-deps --no-build-isolation --editable . || exit 1
