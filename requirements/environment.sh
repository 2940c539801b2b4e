#!/bin/sh
# Makes the environment of a checkout: environment.sh FOLDER [PYTHON]
#
# pybullet has wheels for Python 3.11 and 3.10 on x86-64 Linux alone. So these are taken before other versions, also
# where only uv or pyenv keeps them. Elsewhere pybullet is compiled, which needs a C++ compiler and Python's headers.
set -u
folder=$1
named=${2:-}
wheels="3.11 3.10"
[ "$(uname -sm)" = "Linux x86_64" ] || wheels=
uv_kept=${UV_PYTHON_INSTALL_DIR:-${XDG_DATA_HOME:-${HOME:-}/.local/share}/uv/python}
pyenv_kept=${PYENV_ROOT:-${HOME:-}/.pyenv}/versions

fail() {
    echo "$1" >&2
    exit 1
}

# One a line: the named interpreter alone, or else those to choose from.
candidates() {
    if [ -n "$named" ]; then echo "$named"; return; fi
    for version in 3.11 3.10; do
        echo "python$version"
        for kept in "$uv_kept/cpython-$version".*/bin "$pyenv_kept/$version".*/bin; do
            if [ -x "$kept/python$version" ]; then echo "$kept/python$version"; fi
        done
    done
    printf '%s\n' python3 python3.13 python3.12 python
}

can_compile() {
    command -v c++ >/dev/null || command -v g++ >/dev/null || command -v clang++ >/dev/null || return 1
    "$1" -c 'import os, sysconfig, sys; sys.exit(not os.path.exists(sysconfig.get_paths()["include"] + "/Python.h"))'
}

rm -rf "$folder"
found= found_version= bare= old=
IFS='
'
for python in $(candidates); do
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) || continue
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { old="$old $python is $version."; continue; }
    "$python" -c 'import venv, ensurepip' 2>/dev/null || { bare=$version; continue; }
    if [ -z "$found" ]; then found=$python found_version=$version; fi
    case " $wheels " in *" $version "*) found=$python found_version=$version; break;; esac
done

if [ -z "$found" ] && [ -n "$bare" ]; then
    fail "Python $bare lacks the venv module (Debian, Ubuntu: apt install python$bare-venv)."
elif [ -z "$found" ] && [ -n "$named" ] && [ -z "$old" ]; then
    fail "PYTHON=$named cannot be run, expected a Python of 3.10 or newer: its name or its whole path"
elif [ -z "$found" ]; then
    fail "KIT1000 needs Python 3.10 or newer.$old Name one: make install PYTHON=/path/to/python3"
fi
case " $wheels " in
    *" $found_version "*) ;;
    *)
        get="get Python 3.11, which has a wheel (uv python install 3.11), or a C++ compiler and the headers of Python"
        can_compile "$found" || fail "pybullet has no wheel for Python $found_version here, and it cannot be compiled: \
$get (Debian, Ubuntu: apt install g++ python$found_version-dev)."
        ;;
esac
"$found" -m venv "$folder"
