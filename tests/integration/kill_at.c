/* Preloaded into the flight process: kills it right before its KILL_AT-th change of a file. With KILL_TORN
 * set, a write that is hit is done by half first. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>

static long s_count;

/* 1 if this is the one. */
static int hit(void)
{
    const char *at = getenv("KILL_AT");
    return at != NULL && ++s_count == atol(at);
}

static void die(void) { (void)kill(getpid(), SIGKILL); }

ssize_t write(int fd, const void *buf, size_t n)
{
    ssize_t (*real)(int, const void *, size_t) = (ssize_t(*)(int, const void *, size_t))dlsym(RTLD_NEXT,
                                                                                              "write");
    /* Sockets and pipes of LCM are not files; ours are opened in the store and larger than a byte. */
    if (n > 1u && hit()) {
        if (getenv("KILL_TORN") != NULL) { (void)real(fd, buf, n / 2u); }
        die();
    }
    return real(fd, buf, n);
}

int fsync(int fd)
{
    int (*real)(int) = (int (*)(int))dlsym(RTLD_NEXT, "fsync");
    if (hit()) { die(); }
    return real(fd);
}

int renameat(int from_fd, const char *from, int to_fd, const char *to)
{
    int (*real)(int, const char *, int,
                const char *) = (int (*)(int, const char *, int, const char *))dlsym(RTLD_NEXT, "renameat");
    if (hit()) { die(); }
    return real(from_fd, from, to_fd, to);
}

int unlinkat(int fd, const char *name, int flags)
{
    int (*real)(int, const char *, int) = (int (*)(int, const char *, int))dlsym(RTLD_NEXT, "unlinkat");
    if (hit()) { die(); }
    return real(fd, name, flags);
}
