/* States of an instance: saved, restored, written as bytes, damaged, read back. */
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"

/* Damage may undo itself: then the bytes serialise to what they are. */
static int repaired(Fuzz *f, size_t k, size_t j)
{
    unsigned char *again = calloc(f->kept_size[j], 1);
    const int same = fmi2SerializeFMUstate(f->slots[f->owner[k]].c, f->states[k], again, f->kept_size[j]) == fmi2OK
                     && memcmp(again, f->kept[j], f->kept_size[j]) == 0;
    free(again);
    return same;
}

void fuzz_save(Fuzz *f, int slot, int natural)
{
    Slot *s = &f->slots[slot];
    const size_t k = random_below(STATES), j = random_below(KEPT);
    const int own = f->states[k] == NULL || f->owner[k] == slot;
    size_t size = 0;
    fmi2FMUstate none = NULL;

    switch (random_below(natural ? 5 : 7)) {
    case 0:
        if (!own || (natural && s->phase == BROKEN)) break;
        const int broken = s->phase == BROKEN;
        if (fuzz_told(f, s, fmi2GetFMUstate(s->c, OR_NULL(&f->states[k]))) == fmi2OK) {
            if (broken) fuzz_broken(f, "the state of an instance was saved after an error");
            f->owner[k] = slot;
            f->phase_of[k] = s->phase;
        }
        return;
    case 1:
        if (natural && f->states[k] == NULL) break;
        if (fuzz_told(f, s, fmi2SetFMUstate(s->c, f->states[k])) == fmi2OK) {
            if (f->states[k] == NULL || f->slots[f->owner[k]].type != s->type)
                fuzz_broken(f, "a state of the other interface was restored");
            s->phase = f->phase_of[k];
            ++f->restored;
        }
        return;
    case 2:
        if (!own || s->c == NULL) break;
        fuzz_told(f, s, fmi2FreeFMUstate(s->c, &f->states[k]));
        return;
    case 3:
        if (natural && f->states[k] == NULL) break;
        if (fuzz_told(f, s, fmi2SerializedFMUstateSize(s->c, f->states[k], &size)) != fmi2OK) return;
        free(f->kept[j]);
        f->kept_size[j] = size;
        f->kept[j] = calloc(size, 1);
        f->kept_phase[j] = f->phase_of[k];
        f->kept_damaged[j] = 1; /* until all of it is written */
        if (fuzz_told(f, s, fmi2SerializeFMUstate(s->c, f->states[k], f->kept[j],
                                                  natural ? size : random_below(size + 1))) == fmi2OK)
            f->kept_damaged[j] = 0;
        return;
    case 4:
        if (f->kept[j] == NULL || f->states[k] != NULL) break;
        if (!natural || chance(20)) {
            f->kept[j][random_below(f->kept_size[j])] ^= (unsigned char)(1u << random_below(8));
            f->kept_damaged[j] = 1; /* for good: that the same bit changes back is not waited for */
        }
        if (fuzz_told(f, s, fmi2DeSerializeFMUstate(s->c, f->kept[j],
                                                    natural ? f->kept_size[j] : random_below(f->kept_size[j] + 1),
                                                    &f->states[k])) == fmi2OK) {
            f->owner[k] = slot;
            f->phase_of[k] = f->kept_phase[j];
            if (f->kept_damaged[j] && !repaired(f, k, j)) fuzz_broken(f, "a damaged state was accepted");
        }
        return;
    case 5: fuzz_told(f, s, fmi2SetFMUstate(s->c, NULL)); return;
    default: break;
    }
    fuzz_told(f, s, fmi2FreeFMUstate(s->c, &none));
}
