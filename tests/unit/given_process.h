/* What this process says, and the files that it has open. For tests of fsw/lcm. */
#ifndef GIVEN_PROCESS_H
#define GIVEN_PROCESS_H

#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <unistd.h>

#include "unity.h"

static FILE *s_heard;
static int s_heard_fd, s_unheard;

/* From now on what is written to fd is heard, and goes nowhere else. */
static inline void hear(int fd)
{
    (void)fflush(NULL);
    s_heard = tmpfile();
    TEST_ASSERT_NOT_NULL(s_heard);
    s_heard_fd = fd;
    s_unheard = dup(fd);
    (void)dup2(fileno(s_heard), fd);
}

static inline const char *heard(void)
{
    static char text[4096];
    (void)fflush(NULL);
    (void)dup2(s_unheard, s_heard_fd);
    (void)close(s_unheard);
    ssize_t n = pread(fileno(s_heard), text, sizeof text - 1u, 0);
    (void)fclose(s_heard);
    TEST_ASSERT_TRUE(n >= 0);
    text[n] = '\0';
    return text;
}

static inline uint32_t open_files(void)
{
    uint32_t n = 0u;
    for (int fd = 0; fd < 256; fd++) { n += fcntl(fd, F_GETFD) >= 0; }
    return n;
}

#endif
