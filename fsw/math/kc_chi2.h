#ifndef KC_CHI2_H
#define KC_CHI2_H

#include <stdint.h>

/* chi^2 upper tail probability, dof >= 1 (regularised incomplete gamma); 1 for chi2 <= 0, NaN for NaN. */
double kc_chi2_sf(double chi2, uint32_t dof);

#endif
