/* Preloaded library that simulates a slow disk. The environment variable SLOW_DISK names a file with a number of
   milliseconds; every fsync is delayed by that time. Without the file there is no delay. The library appends to the file
   with the additional suffix .effects: an s for each delayed fsync, an f for each write that failed on a full disk. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

static void note(const char *what) {
    const char *name = getenv("SLOW_DISK");
    char path[4096];
    int kept = errno;
    if (name && snprintf(path, sizeof path, "%s.effects", name) < (int)sizeof path) {
        int file = open(path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
        if (file >= 0) {
            syscall(SYS_write, file, what, 1);
            close(file);
        }
    }
    errno = kept;
}

static void drag(void) {
    const char *name = getenv("SLOW_DISK");
    FILE *file = name ? fopen(name, "r") : NULL;
    int milliseconds = 0;
    if (file) {
        if (fscanf(file, "%d", &milliseconds) != 1) milliseconds = 0;
        fclose(file);
    }
    if (milliseconds > 0 && milliseconds <= 10000) {
        note("s");
        usleep(1000u * (unsigned)milliseconds);
    }
}

static ssize_t noted(ssize_t written) {
    if (written < 0 && errno == ENOSPC) note("f");
    return written;
}

#define REAL(name)                                                 \
    static __typeof__(name)(*real);                                \
    if (!real) real = (__typeof__(real))dlsym(RTLD_NEXT, #name);   \
    return

int fsync(int descriptor) {
    drag();
    REAL(fsync) real(descriptor);
}

int fdatasync(int descriptor) {
    drag();
    REAL(fdatasync) real(descriptor);
}

ssize_t write(int descriptor, const void *data, size_t size) {
    REAL(write) noted(real(descriptor, data, size));
}

ssize_t pwrite(int descriptor, const void *data, size_t size, off_t offset) {
    REAL(pwrite) noted(real(descriptor, data, size, offset));
}

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t offset) {
    REAL(pwrite64) noted(real(descriptor, data, size, offset));
}
