/* Fields that a struct of the core and an LCM message (fsw/msg) have in common, listed once:
 *
 *   #define KC_THING_FIELDS(F, A) F(uint32_t, session) F(double, energy_j) A(double, coef, KC_COEF_MAX)
 *
 * F is one value, A an array. The struct is made of the list, and fsw/lcm/kc_wire.c copies by it: names and sizes
 * are those of the message, bits are kept (LCM has no unsigned types). What the message names or lays out otherwise
 * stands in the struct behind the list and is copied by hand. */
#ifndef KC_FIELDS_H
#define KC_FIELDS_H

#define KC_FIELD_(type, name) type name;
#define KC_ARRAY_(type, name, count) type name[count];

#endif
