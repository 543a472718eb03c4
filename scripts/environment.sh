# Sourced by ./demo and ./check, in the root of the checkout: `prepare EXTRA` makes .venv if it is
# missing and installs the package into it with that extra, unless that is done already.

usable='import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))'

find_python() {
    for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.11 python3.14 python}; do
        if "$candidate" -c "$usable" >/dev/null 2>&1; then
            printf '%s\n' "$candidate"
            return 0
        fi
    done
    cat >&2 <<MESSAGE
jaxwillmore needs Python 3.11 or later with the modules venv and ensurepip; none was found among:
${PYTHON:-python3 python3.13 python3.12 python3.11 python3.14 python}.
Install one (on Debian and Ubuntu also the package python3-venv), or name it: PYTHON=/path/to/python3 $0
MESSAGE
    return 1
}

prepare() {
    extra=$1
    stamp=.venv/jaxwillmore-$extra.stamp
    wanted=$(cat pyproject.toml constraints.txt | cksum)
    if [ -x .venv/bin/python ] && [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then
        return 0
    fi
    if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
        python=$(find_python)
        echo "Making the environment .venv with $("$python" --version)."
        "$python" -m venv --clear .venv
    elif ! .venv/bin/python -c "$usable" >/dev/null 2>&1; then
        echo "The environment .venv has $(.venv/bin/python --version); jaxwillmore needs 3.11 or later. Remove .venv and start again." >&2
        return 1
    fi
    echo "Installing jaxwillmore[$extra] into .venv (about 1 GB; some minutes on a slow network)."
    .venv/bin/python -m pip install --quiet --disable-pip-version-check \
        --constraint constraints.txt --editable ".[$extra]"
    printf '%s\n' "$wanted" >"$stamp"
}
