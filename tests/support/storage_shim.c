/* Between a program and its files: counts what it writes and syncs below the directory SHIM_DIR, and at number SHIM_AT
 * refuses (SHIM_MODE=fail, from there on always with SHIM_MODE=dead), hangs for ever (freeze), or hangs after half of
 * the bytes (torn); SHIM_MODE=often refuses each SHIM_AT-th one for as long as the file SHIM_SWITCH exists. The file
 * descriptor SHIM_TELL hears of a hang; SHIM_COUNT names the file for the count at the end.
 * Preloaded by tests/faults, which compile it. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static unsigned long counted;

static int is_ours(int descriptor) {
    const char *directory = getenv("SHIM_DIR");
    char link[64], path[4096];
    if (!directory) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return strncmp(path, directory, strlen(directory)) == 0;
}

static void hang(void) {
    /* The descriptor told is none of ours, so this write is not counted. */
    const char *tell = getenv("SHIM_TELL");
    if (tell) (void)!write(atoi(tell), "\nfrozen\n", 8);
    for (;;) pause();
}

enum what { GO_ON, REFUSE, HALF };

static enum what decide(int descriptor) {
    if (!is_ours(descriptor)) return GO_ON;
    const char *at = getenv("SHIM_AT"), *mode = getenv("SHIM_MODE");
    pthread_mutex_lock(&lock);
    unsigned long number = ++counted;
    pthread_mutex_unlock(&lock);
    unsigned long wanted = at ? strtoul(at, NULL, 10) : 0;
    if (!mode || !wanted || number < wanted) return GO_ON;
    if (!strcmp(mode, "often")) {
        const char *file = getenv("SHIM_SWITCH");
        return file && number % wanted == 0 && access(file, F_OK) == 0 ? REFUSE : GO_ON;
    }
    if (!strcmp(mode, "dead")) return REFUSE;
    if (number > wanted) return GO_ON;
    if (!strcmp(mode, "fail")) return REFUSE;
    if (!strcmp(mode, "torn")) return HALF;
    hang();
    return GO_ON;
}

__attribute__((destructor)) static void tell_count(void) {
    const char *name = getenv("SHIM_COUNT");
    FILE *file = name ? fopen(name, "w") : NULL;
    if (!file) return;
    fprintf(file, "%lu\n", counted);
    fclose(file);
}

#define REAL(name) static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

#define AROUND_WRITE(part)                                                                                             \
    switch (decide(descriptor)) {                                                                                      \
    case REFUSE: errno = EIO; return -1;                                                                               \
    case HALF: part; hang(); break;                                                                                    \
    case GO_ON: break;                                                                                                 \
    }

ssize_t write(int descriptor, const void *bytes, size_t length) {
    REAL(write);
    AROUND_WRITE((void)!real(descriptor, bytes, length / 2))
    return real(descriptor, bytes, length);
}

ssize_t pwrite(int descriptor, const void *bytes, size_t length, off_t place) {
    REAL(pwrite);
    AROUND_WRITE((void)!real(descriptor, bytes, length / 2, place))
    return real(descriptor, bytes, length, place);
}

ssize_t pwrite64(int descriptor, const void *bytes, size_t length, off64_t place) {
    REAL(pwrite64);
    AROUND_WRITE((void)!real(descriptor, bytes, length / 2, place))
    return real(descriptor, bytes, length, place);
}

ssize_t writev(int descriptor, const struct iovec *parts, int count) {
    REAL(writev);
    AROUND_WRITE((void)0)
    return real(descriptor, parts, count);
}

int fsync(int descriptor) {
    REAL(fsync);
    AROUND_WRITE((void)0)
    return real(descriptor);
}

int fdatasync(int descriptor) {
    REAL(fdatasync);
    AROUND_WRITE((void)0)
    return real(descriptor);
}

int ftruncate(int descriptor, off_t length) {
    REAL(ftruncate);
    AROUND_WRITE((void)0)
    return real(descriptor, length);
}

int ftruncate64(int descriptor, off64_t length) {
    REAL(ftruncate64);
    AROUND_WRITE((void)0)
    return real(descriptor, length);
}
