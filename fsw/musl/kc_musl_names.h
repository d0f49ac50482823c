/* The names under which musl's mathematics is compiled; included before each of its files (fsw/CMakeLists.txt).
 *
 * What kc_libm.h declares is called kc_..., the rest kc_musl_...: neither meets the mathematics library of the process
 * that the core is loaded into. */
#ifndef KC_MUSL_NAMES_H
#define KC_MUSL_NAMES_H

/* Before the names change, so that the system's headers are read as they are. */
#include <float.h>
#include <math.h>

#include "kc_libm.h"

/* What musl's own <features.h> says. No second name for lgamma_r. */
#define hidden __attribute__((__visibility__("hidden")))
#define weak_alias(old, new) _Static_assert(1, #old)

#define sin kc_musl_sin
#define cos kc_musl_cos
#define tan kc_musl_tan
#define acos kc_acos
#define atan2 kc_atan2
#define exp kc_exp
#define log kc_log
#define log1p kc_log1p
#define tanh kc_tanh
#define floor kc_floor

#define __lgamma_r kc_musl_lgamma_r
#define atan kc_musl_atan
#define expm1 kc_musl_expm1
#define scalbn kc_musl_scalbn
hidden double atan(double x);
hidden double expm1(double x);
hidden double scalbn(double x, int n);
#define __sin kc_musl_sin_kernel
#define __cos kc_musl_cos_kernel
#define __tan kc_musl_tan_kernel
#define __rem_pio2 kc_musl_rem_pio2
#define __rem_pio2_large kc_musl_rem_pio2_large
#define __exp_data kc_musl_exp_data
#define __log_data kc_musl_log_data
#define __math_divzero kc_musl_divzero
#define __math_invalid kc_musl_invalid
#define __math_oflow kc_musl_oflow
#define __math_uflow kc_musl_uflow
#define __math_xflow kc_musl_xflow
/* Only declared: glibc has others of these names. */
#define __sinl kc_musl_sinl
#define __cosl kc_musl_cosl
#define __tanl kc_musl_tanl

/* The same steps on every CPU: log has others where it may use fused multiply-add. */
#undef __FP_FAST_FMA
/* Nothing here computes in long double; musl does not know the one of POWER. */
#undef LDBL_MANT_DIG
#undef LDBL_MAX_EXP
#define LDBL_MANT_DIG DBL_MANT_DIG
#define LDBL_MAX_EXP DBL_MAX_EXP

#endif
