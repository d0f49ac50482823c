/* Tests of a program: the build lists them in front of their source (CMakeLists.txt), given_main.c runs them. */
#ifndef GIVEN_MAIN_H
#define GIVEN_MAIN_H

typedef struct {
    const char *name;
    void (*run)(void);
} given_test_t;

extern const char given_source[];
extern const given_test_t given_tests[]; /* behind the last is one without a name */

#endif
