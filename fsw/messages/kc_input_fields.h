/* Names of the inputs and of their fields, as events number them. */
#ifndef KC_INPUT_FIELDS_H
#define KC_INPUT_FIELDS_H

#include <stdint.h>

#include "kc_sensors.h"

/* Inputs as events KC_EVT_IN_* name them. */
typedef enum { KC_INPUT_ARM = 1, KC_INPUT_PANTILT = 2, KC_INPUT_DETECTION = 3 } kc_sensor_t;

/* Fields of the inputs, index of IN_RANGE: 100 x input + number, as the message files say (fsw/msg). X(first, count, NAME,
 * "name"): a field of `count` elements takes as many numbers from `first` on. */
#define KC_INPUT_FIELD_LIST(X) \
    KC_INPUT_MESSAGE_LIST(X)   \
    X(315, 1u, DET_COV_SHAPE, "detection cov, which is not positive definite,")

#define KC_INPUT_FIELD_ENUM_(first, count, NAME, name) KC_FIELD_##NAME = (first),
typedef enum { KC_INPUT_FIELD_LIST(KC_INPUT_FIELD_ENUM_) } kc_field_t;

/* Name of a field as above, "" for none; never NULL. *element: which one, from 1; 0 if the field has one
 * only. */
const char *kc_input_field(int32_t index, uint32_t *element);

#endif
