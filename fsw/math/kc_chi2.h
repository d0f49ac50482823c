#ifndef KC_CHI2_H
#define KC_CHI2_H

#include <stdint.h>

/* chi^2 upper tail probability, dof >= 1 (regularised incomplete gamma); 1 for chi2 <= 0, NaN for NaN. */
double kc_chi2_sf(double chi2, uint32_t dof);
/* Where the upper tail has probability p, 1e-4 or more (less: of 1e-4 or somewhat less), to 1e-9 of dof. */
double kc_chi2_quantile(double p, uint32_t dof);

#endif
