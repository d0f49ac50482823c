/* What the replay needs of the machine: tests/cross/host.c under an operating system, tests/cross/mps2.c without. */
#ifndef REPLAY_H
#define REPLAY_H

#include <stdint.h>

/* Step the core with the record; 0 if the record ended where it should. */
int replay(void);

/* Next bytes of the record; how many there were. */
uint32_t replay_read(uint8_t *to, uint32_t n);
void replay_print(const char *text);

#endif
