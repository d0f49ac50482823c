/* What boot reads: slots of the store and table files, as kc_files.c reads them from a folder in memory, into the
 * component, and its first steps.
 *
 * Input: changes of the files that an approved calibration and a correction that waits for review leave; each a
 * file, how, and places at which it is spoiled. CRCs are made right again, or not. */
#define _GNU_SOURCE /* NOLINT: mkdtemp, openat */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "fuzz.h"
#include "given_tables.h"
#include "given_world.h"
#include "kc_crc.h"
#include "kc_files.h"

#define APP (&kc_app_instance)
#define CHANGES_MAX 6u

static const uint16_t s_kind[] = {KC_STORE_JOURNAL,  KC_TBL_KIN,    KC_STORE_PREV,
                                  KC_STORE_PROPOSAL, KC_TBL_CONFIG, KC_TBL_ARM};
#define KINDS (sizeof s_kind / sizeof s_kind[0])

typedef struct {
    uint8_t data[4096];
    uint32_t n; /* 0: there is no such file */
    bool changed;
} file_t;

static char s_dir[64], s_tables[96];
static kc_files_t s_files;
static file_t s_file[KINDS][2];
static const kc_in_t s_no_in;
static kc_out_t s_out;

static void name_of(char name[16], uint32_t i, uint32_t slot)
{
    (void)snprintf(name, 16u, "k%02u.%c", (unsigned)s_kind[i], slot == 0u ? 'a' : 'b');
}

static void write_file(int dir, const char *name, const uint8_t *data, uint32_t n)
{
    int fd = openat(dir, name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    MUST(fd >= 0 && write(fd, data, n) == (ssize_t)n && close(fd) == 0);
}

static void put_file(int dir, uint32_t i, uint32_t slot, const uint8_t *data, uint32_t n, bool there)
{
    char name[16];
    name_of(name, i, slot);
    if (there) {
        write_file(dir, name, data, n);
    } else {
        (void)unlinkat(dir, name, 0);
    }
}

static kc_status_t keep(const kc_store_t *s) { return kc_files_store(&s_files, s); }

static void read_file(uint32_t i, uint32_t slot)
{
    file_t *f = &s_file[i][slot];
    char name[16];
    name_of(name, i, slot);
    int fd = openat(s_files.dir_fd, name, O_RDONLY | O_CLOEXEC);
    if (fd < 0) { return; }
    ssize_t n = read(fd, f->data, sizeof f->data);
    MUST(n > 0 && close(fd) == 0);
    f->n = (uint32_t)n;
}

static void remove_all(void)
{
    char command[128];
    (void)snprintf(command, sizeof command, "rm -rf %s", s_dir);
    if (system(command) != 0) { perror(command); }
}

/* An approved correction, the one before it, and one that waits for review. */
static void calibrate(void)
{
    world.keep = keep;
    world_calibrated();
    MUST(kc_app_state(APP) == KC_ST_REVIEW);
    MUST(world_do(KC_CMD_APPROVE_ARM, (int32_t)APP->review.crc, 0, 0) == KC_OK);
    MUST(world_do(KC_CMD_APPROVE_GO, (int32_t)APP->review.crc, 0, 0) == KC_OK);
    MUST(world_stored(100u));
    world.bias[0] = -0.1;
    MUST(world_do(KC_CMD_START, -1, 0, 3) == KC_OK);
    MUST(world_until(KC_ST_REVIEW, 4000u));
    world_ticks(3u);
}

/* A table's file too may be in the store: CONFIG and ARM are, as if they had been sent up. */
static void store_table(uint16_t kind)
{
    kc_store_t s = {.kind = kind, .n = fuzz_image[kind].n, .data = fuzz_image[kind].data};
    MUST(kc_files_store(&s_files, &s) == KC_OK);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    (void)argc;
    (void)argv;
    (void)snprintf(s_dir, sizeof s_dir, "%s/kincal-fuzz-XXXXXX",
                   access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp");
    MUST(mkdtemp(s_dir) != NULL && atexit(remove_all) == 0);
    (void)snprintf(s_tables, sizeof s_tables, "%s/tables", s_dir);
    MUST(mkdir(s_tables, 0700) == 0);
    MUST(kc_files_open(&s_files, s_dir));
    fuzz_given_world(0u);
    world.bias[1] = 0.05;
    calibrate();
    store_table(KC_TBL_ARM);
    store_table(KC_TBL_CONFIG);
    for (uint32_t i = 0u; i < KINDS; i++) {
        read_file(i, 0u);
        read_file(i, 1u);
    }
    int dir = open(s_tables, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        char name[16];
        if (kind == KC_TBL_KIN || kind == KC_TBL_SPACE) { continue; } /* large, and nothing here needs it */
        (void)snprintf(name, sizeof name, "%u.tbl", (unsigned)kind);
        write_file(dir, name, fuzz_image[kind].data, fuzz_image[kind].n);
    }
    MUST(close(dir) == 0 && freopen("/dev/null", "w", stdout) != NULL);
    MUST(close(s_files.dir_fd) == 0);
    return 0;
}

static void put_le32(uint8_t *b, uint32_t v)
{
    for (uint32_t i = 0u; i < 4u; i++) { b[i] = (uint8_t)(v >> (8u * i)); }
}

/* CRC of the content, then size and CRC of the slot. */
static void seal(uint16_t kind, uint8_t *data, uint32_t n, uint8_t how)
{
    uint8_t *content = &data[KC_SLOT_HDR_BYTES];
    if (n < KC_SLOT_HDR_BYTES + 16u) { return; }
    uint32_t bytes = n - KC_SLOT_HDR_BYTES;
    if ((how & 4u) == 0u) {
        if (kind == KC_STORE_JOURNAL) {
            put_le32(&content[bytes - 4u], kc_crc32(0u, content, bytes - 4u));
        } else {
            fuzz_seal_image(kind < KC_TBL_COUNT ? kind : KC_TBL_KIN, content, bytes);
        }
    }
    if ((how & 8u) == 0u) {
        put_le32(&data[16], bytes);
        put_le32(&data[20], kc_crc32(kc_crc32(0u, data, 20u), content, bytes));
    }
}

/* A file is deleted, cut, spoiled, or becomes what another one is. */
static void change(fuzz_t *f, int dir)
{
    static uint8_t data[4096];
    uint32_t i = fuzz_u8(f) % KINDS, slot = fuzz_u8(f) & 1u, n;
    uint8_t how = fuzz_u8(f);
    const file_t *from = &s_file[(how & 16u) ? fuzz_u8(f) % KINDS : i][(how & 32u) ? 1u - slot : slot];
    s_file[i][slot].changed = true;
    memcpy(data, from->data, from->n);
    n = from->n;
    if ((how & 16u) && n > 5u) { data[4] = (uint8_t)s_kind[i]; }
    if (how & 2u) { n = fuzz_u16(f) % (n + 1u); }
    fuzz_spoil(f, data, n);
    seal(s_kind[i], data, n, how);
    put_file(dir, i, slot, data, n, (how & 1u) == 0u && from->n > 0u);
}

static void restore(int dir)
{
    for (uint32_t i = 0u; i < KINDS; i++) {
        for (uint32_t slot = 0u; slot < 2u; slot++) {
            file_t *f = &s_file[i][slot];
            if (f->changed) { put_file(dir, i, slot, f->data, f->n, f->n > 0u); }
            f->changed = false;
        }
    }
}

/* What holds after every boot, whatever was read. */
static void check_boot(void)
{
    const kc_active_t *a = kc_app_active(APP);
    kc_state_t state = kc_app_state(APP);
    MUST(state == KC_ST_IDLE || state == KC_ST_SAFE || state == KC_ST_REVIEW);
    MUST((state == KC_ST_REVIEW) == (APP->review.crc != 0u));
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        MUST(a->crc[kind] != 0u || kind == KC_TBL_TERMS || kind == KC_TBL_KIN || kind == KC_TBL_SPACE);
    }
    fuzz_check_tables(a);
    for (uint32_t i = 0u; i < 2u; i++) {
        uint32_t kin_crc = a->crc[KC_TBL_KIN];
        kc_state_t before = kc_app_state(APP);
        kc_app_step(APP, 5000000u + i * 100000u, &s_no_in, &s_out);
        fuzz_check_step(APP, &s_out, before, kin_crc);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_t f = {data, size};
    int dir = open(s_dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    for (uint32_t i = 0u; i < CHANGES_MAX && f.left > 0u; i++) { change(&f, dir); }
    MUST(kc_files_open(&s_files, s_dir));
    kc_app_init(APP);
    kc_app_keys(APP, &world.keys);
    MUST(kc_files_load(&s_files, s_tables, APP) == 5);
    kc_app_boot(APP);
    check_boot();
    restore(dir);
    MUST(close(s_files.dir_fd) == 0 && close(dir) == 0);
    return 0;
}
