/* The only access to the C mathematics library: double precision only.
 *
 * Flight code calls these and never libm itself, so the library can be exchanged in one place
 * on a CPU whose libm gives other bits. */
#ifndef KC_LIBM_H
#define KC_LIBM_H

#include <math.h>

#define KC_PI 3.14159265358979323846
#define KC_INF HUGE_VAL

static inline double kc_sin(double x) { return sin(x); }
static inline double kc_cos(double x) { return cos(x); }
static inline double kc_tan(double x) { return tan(x); }
static inline double kc_asin(double x) { return asin(x); }
static inline double kc_acos(double x) { return acos(x); }
static inline double kc_atan2(double y, double x) { return atan2(y, x); }
static inline double kc_sqrt(double x) { return sqrt(x); }
static inline double kc_exp(double x) { return exp(x); }
static inline double kc_log(double x) { return log(x); }
static inline double kc_log1p(double x) { return log1p(x); }
static inline double kc_lgamma(double x) { return lgamma(x); }
static inline double kc_tanh(double x) { return tanh(x); }
static inline double kc_fabs(double x) { return fabs(x); }
static inline double kc_floor(double x) { return floor(x); }

/* These give the second argument for a NaN in the first, unlike fmin and fmax. */
static inline double kc_min(double a, double b) { return a < b ? a : b; }
static inline double kc_max(double a, double b) { return a > b ? a : b; }
static inline double kc_clamp(double x, double lo, double hi) { return kc_min(kc_max(x, lo), hi); }

static inline int kc_finite(double x) { return isfinite(x) != 0; }

#endif
