/* A small arm for unit tests: one prismatic and two revolute joints, oblique base and tool. */
#ifndef GIVEN_SMALL_ARM_H
#define GIVEN_SMALL_ARM_H

#include "kc_arm.h"

void given_small_arm(kc_arm_t *arm);

#endif
