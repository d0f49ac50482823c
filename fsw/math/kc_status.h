/* The one status type. Zero is good, negative is an error; the list is complete. */
#ifndef KC_STATUS_H
#define KC_STATUS_H

typedef enum {
    KC_OK = 0,
    KC_ERR_ARG = -1,    /* the caller passed something impossible */
    KC_ERR_FULL = -2,   /* fixed capacity reached, nothing changed */
    KC_ERR_NUM = -3,    /* not positive definite, or not finite */
    KC_ERR_ITER = -4,   /* iteration limit; the best point so far is kept */
    KC_ERR_CRC = -5,    /* checksum differs */
    KC_ERR_FORMAT = -6, /* magic, kind, version or size of an image is wrong */
    KC_ERR_RANGE = -7,  /* a value lies outside its allowed range */
    KC_ERR_STATE = -8,  /* not now: the state does not allow it */
    KC_ERR_STALE = -9,  /* too old, repeated or out of sequence */
    KC_ERR_RANK = -10,  /* the data do not determine what was requested */
    KC_ERR_REACH = -11, /* no joint angles reach the pose inside the limits */
    KC_ERR_PATH = -12,  /* no verified path */
    KC_ERR_AUTH = -13   /* not signed, or with a key or a MAC that is not right */
} kc_status_t;

/* Short name of a status, for people ("KC_OK", "KC_ERR_ARG" ...); never NULL. */
const char *kc_status_name(kc_status_t st);

#endif
