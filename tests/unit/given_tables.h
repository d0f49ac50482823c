/* Good tables for tests: the 7-DOF WAM of the manual with small, quick companions. Tests spoil copies. */
#ifndef GIVEN_TABLES_H
#define GIVEN_TABLES_H

#include "kc_tables.h"

void given_arm(kc_arm_t *a);
void given_camera(kc_camera_t *c);
void given_terms(kc_terms_t *t);   /* 28 DH coefficients */
void given_kin(kc_kin_t *k);       /* nominal, for given_terms */
void given_kernel(kc_kernel_t *k);
void given_config(kc_config_t *c);
/* n_cand candidates around two hubs, poses by nominal forward kinematics; odd ones hang on hub 1. The only
 * direct edges are between candidates k and k + 2. */
void given_space(kc_space_t *s, uint32_t n_cand, uint32_t arm_crc);
/* Hubs in a chain 0-1-2-...-(n-1), candidate k on hub k. */
void given_chain(kc_space_t *s, uint32_t n);

/* Image of a table in a buffer of KC_IMAGE_MAX bytes; returns its size. */
uint32_t given_image(uint16_t kind, const void *table, uint8_t *image);
/* Give the image a right CRC after a test changed its payload or size. */
void given_resealed(uint8_t *image, uint32_t n);

/* The events of a kind are in q exactly once; -1 if not, else its place. */
int event_at(const kc_events_t *q, uint16_t id);

#endif
