/* The replay under an operating system, in the folder of the record. */
#include <stdio.h>

#include "replay.h"

static FILE *record;

uint32_t replay_read(uint8_t *to, uint32_t n) { return (uint32_t)fread(to, 1u, n, record); }

void replay_print(const char *text) { (void)fputs(text, stdout); }

int main(void)
{
    record = fopen("record.bin", "rb");
    if (record == NULL) {
        perror("record.bin");
        return 1;
    }
    return replay();
}
