/* What is commanded, by whom, and what may come signed. */
#ifndef KC_OPCODES_H
#define KC_OPCODES_H

typedef enum {
    KC_CMD_NOOP = 0,
    KC_CMD_START = 1,
    KC_CMD_ABORT = 2,
    KC_CMD_APPROVE_ARM = 3,
    KC_CMD_APPROVE_GO = 4,
    KC_CMD_REJECT = 5,
    KC_CMD_ROLLBACK = 6,
    KC_CMD_TABLE_VALIDATE = 7,
    KC_CMD_TABLE_ACTIVATE = 8,
    KC_CMD_TABLE_DISCARD = 9,
    KC_CMD_TABLE_DUMP = 10
} kc_opcode_t;

/* arg_i[1] of APPROVE_ARM. FIT: although the fit is poor, or its verdict is not known. */
#define KC_OVERRIDE_NONE 0
#define KC_OVERRIDE_FIT 1

/* Who commands; sequence numbers are kept per source. */
typedef enum { KC_SRC_EXECUTIVE = 1, KC_SRC_GROUND = 2 } kc_source_t;
#define KC_SOURCE_MAX 2u

/* What may come signed. Each has counters of its own, so that their order within a step does not matter. */
typedef enum { KC_SIGNED_CMD = 0, KC_SIGNED_CHUNK = 1 } kc_signed_kind_t;
#define KC_SIGNED_COUNT 2u

#endif
