#ifndef KC_CHI2_H
#define KC_CHI2_H

#include <stdint.h>

/* chi^2 upper tail probability, dof >= 1 (regularised incomplete gamma); 1 for chi2 <= 0, NaN for NaN. */
double kc_chi2_sf(double chi2, uint32_t dof);
/* Where the upper tail has probability p, 1e-4 or more (less: of 1e-4 or somewhat less), to 1e-9 of dof. */
double kc_chi2_quantile(double p, uint32_t dof);
double kc_chi2_quantile_real(double p, double dof); /* dof >= 1, not whole */
/* Upper tail of the noncentral chi^2, a Poisson mixture of central ones (Johnson & Kotz), ncp >= 0; one above 200
 * counts as 200. */
double kc_chi2_noncentral_sf(double chi2, uint32_t dof, double ncp);
#define KC_CHI2_NONCENTRAL_COST 2000000u /* bound of its instructions, up to 400 dof */

#endif
