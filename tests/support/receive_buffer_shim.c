/* A machine with small receive buffers: a program started with this in LD_PRELOAD gets no more than 64 kB for a socket,
   whatever it asks for. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stddef.h>
#include <sys/socket.h>

typedef int (*set_option)(int, int, int, const void *, socklen_t);

int setsockopt(int socket, int level, int name, const void *value, socklen_t length) {
    static set_option real;
    static const int small = 32 << 10; /* the kernel doubles it */
    if (!real) real = (set_option)dlsym(RTLD_NEXT, "setsockopt");
    if (level == SOL_SOCKET && name == SO_RCVBUF) return real(socket, level, name, &small, sizeof small);
    return real(socket, level, name, value, length);
}
