/* Files: the store that survives power loss, and the directory of default tables.
 *
 * Store: two slots per kind, kNN.a and kNN.b. A write goes to the older slot: temporary file, fsync,
 * read back, rename, fsync of the directory; so at every instant at least the newest slot but one is
 * whole. What the newest slot holds already is not written again. What was not confirmed is removed.
 *
 *   slot: "KCS1", u16 kind, u16 0, u64 number, u32 bytes, u32 CRC-32 of all before and of the data, data
 * all little-endian; the number grows by one with every write of that kind, from 2^64 - 1 to 1.
 *
 * Files are read into buffers of a fixed size. What cannot be read, or is a link, FIFO, device or directory in place
 * of a file, is a bad copy like any other: never a signal, never a wait. */
#ifndef KC_FILES_H
#define KC_FILES_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_app.h"
#include "kc_store.h"

#define KC_SLOT_HDR_BYTES 24u
#define KC_FILES_PATH_MAX 1024
#define KC_FILES_KINDS 32u  /* kinds are smaller than this */
#define KC_FILES_TABLES 64u /* most *.tbl files of a directory */

typedef struct {
    char dir[KC_FILES_PATH_MAX];
    int dir_fd;                         /* also holds the lock */
    uint64_t number[KC_FILES_KINDS][2]; /* by kind and slot, 0 = empty or bad */
    uint8_t there[KC_FILES_KINDS][2];   /* a file exists, good or bad */
} kc_files_t;

/* Open the store, made if missing; only one process may use it. Left-overs of a write that was cut off are
 * removed, and what is there is made to last before it is used. false with the reason on stderr. */
bool kc_files_open(kc_files_t *files, const char *dir);

/* Offer everything to the component, best first: slots newest first, then the *.tbl of `tables`. Slots
 * that cannot be read are offered as empty, so that the component reports them; why is on stderr. Number of table
 * files, 0 if they can't be listed to their end, or -1 if the directory can't be opened, with the reason on stderr. */
int kc_files_load(kc_files_t *files, const char *tables, kc_app_t *app);

/* Write and read back, or (n = 0) delete. KC_OK, or KC_ERR_NUM (not written) or KC_ERR_CRC (reads otherwise) with
 * the reason on stderr; the newest slot is what it was then, as far as the medium obeys. */
kc_status_t kc_files_store(kc_files_t *files, const kc_store_t *request);

#endif
