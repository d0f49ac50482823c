/* Byte layout of every table, one function per kind over the stream of kc_codec.h. docs/TABLES.md
 * shows the same with field numbers. */
#ifndef KC_LAYOUT_H
#define KC_LAYOUT_H

#include "kc_codec.h"
#include "kc_tables.h"

/* Walk the payload of `kind` through table `t`, the struct of that kind. In KC_WALK_SIZE and
 * KC_WALK_WRITE the table is not changed. An unknown kind walks nothing and is lost. */
void kc_layout_walk(kc_walk_t *w, uint16_t kind, void *t);

/* Version of the layout of that kind, 0 for an unknown kind. Each kind counts its own: a CAMERA of another version
 * says nothing about a stored KIN, which still loads. */
uint16_t kc_layout_version(uint16_t kind);

/* Bytes of the struct of that kind, 0 for an unknown kind. */
uint32_t kc_layout_struct_bytes(uint16_t kind);

#endif
