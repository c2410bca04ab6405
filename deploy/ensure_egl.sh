#!/bin/sh
# Checks that an OpenGL context can be opened through EGL; installs Debian's software driver if permitted.
# Never fails: without EGL the fallback renderer is used, and this script prints one line.
python=$1

has_egl() {
    LP_NUM_THREADS=0 "$python" -P -c 'import moderngl; moderngl.create_context(standalone=True, backend="egl").release()' >/dev/null 2>&1
}

has_egl && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "no EGL driver found: installing libegl1 and libgl1-mesa-dri"
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends libegl1 libgl1-mesa-dri; } >/dev/null 2>&1
    has_egl && exit 0
fi
echo "no EGL driver: frames are rendered by the slow fallback renderer; to install one: sudo apt-get install libegl1 libgl1-mesa-dri"
exit 0
