/* Dense algebra and numbers drawn at random, for results that tests compute another way than flight. */
#ifndef GIVEN_DENSE_H
#define GIVEN_DENSE_H

#include <stdint.h>

/* Uniform between -1 and 1. */
double drawn(uint64_t *rng);
double dense_dot(const double *a, const double *b, uint32_t n);
/* Inverse of a positive definite matrix, n x n in rows of ld numbers; what is beyond n becomes zero. */
void dense_invert(uint32_t n, uint32_t ld, const double *in, double *out);
/* x of A x = b, six of each; A is positive definite. */
void dense_solve6(const double *A, const double *b, double *x);
void expect_doubles(const double *want, const double *got, uint32_t n, double tol);

#endif
