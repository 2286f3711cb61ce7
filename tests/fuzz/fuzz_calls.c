/* The calls themselves. Arrays are allocated to the byte, so that an address
 * sanitizer sees a read or write one past their end.                          */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"

static void counted(Fuzz *f, fmi2Status status)
{
    ++f->calls;
    if (status < fmi2OK || status > fmi2Fatal) fuzz_broken(f, "a function returned no fmi2Status");
    if (status <= fmi2Warning) ++f->ok;
    else ++f->refused;
}

fmi2Status fuzz_told(Fuzz *f, Slot *s, fmi2Status status)
{
    counted(f, status);
    if (s->c == NULL) {
        if (status <= fmi2Warning) fuzz_broken(f, "a call without an instance was accepted");
    } else if (status >= fmi2Error) {
        s->phase = BROKEN;
    }
    return status;
}

#define IN(phase) (1u << (phase))

/* States in which values are computed; and those in which they are read, after an error for debugging alone. */
#define COMPUTED (IN(INITIALIZATION) | IN(EVENT) | IN(CONTINUOUS) | IN(STEPPING) | IN(FAILED))
#define READ (COMPUTED | IN(ENDED) | IN(BROKEN))

/* A call that was accepted must have been legal. */
static void legal(const Fuzz *f, const Slot *s, fmi2Status status, unsigned phases, int arguments, const char *what)
{
    if (status <= fmi2Warning && (!arguments || (phases & IN(s->phase)) == 0)) fuzz_broken(f, what);
}

/* Numbers that come with fmi2OK are numbers. */
static void are_finite(const Fuzz *f, fmi2Status status, const double *values, size_t count, const char *what)
{
    for (size_t i = 0; status <= fmi2Warning && i < count; ++i)
        if (!isfinite(values[i])) fuzz_broken(f, what);
}

void fuzz_free(Fuzz *f, int slot)
{
    Slot *s = &f->slots[slot];

    for (int k = 0; k < STATES; ++k)
        if (f->states[k] != NULL && f->owner[k] == slot) {
            counted(f, fmi2FreeFMUstate(s->c, &f->states[k]));
            if (f->states[k] != NULL) fuzz_broken(f, "a freed state is not null");
        }
    fmi2FreeInstance(s->c);
    ++f->calls;
    s->c = NULL;
    s->phase = NONE;
}

/* A copy of the sound file, cut short, lengthened or with a bit changed. */
static void damage_resources(const Fuzz *f)
{
    FILE *from = fopen(f->sound_file, "rb"), *to = fopen(f->bad_file, "wb");
    long size;
    unsigned char *bytes;

    if (from == NULL || to == NULL || fseek(from, 0, SEEK_END) != 0) fuzz_broken(f, "cannot make a damaged file");
    size = ftell(from);
    rewind(from);
    bytes = malloc((size_t)size + 1);
    if (bytes == NULL || fread(bytes, 1, (size_t)size, from) != (size_t)size) fuzz_broken(f, "cannot read");
    switch (random_below(3)) {
    case 0: size = (long)random_below((size_t)size); break;
    case 1: bytes[size++] = (unsigned char)random_bits(); break;
    default: bytes[random_below((size_t)size)] ^= (unsigned char)(1u << random_below(8)); break;
    }
    if (fwrite(bytes, 1, (size_t)size, to) != (size_t)size) fuzz_broken(f, "cannot write a damaged file");
    free(bytes);
    fclose(from);
    fclose(to);
}

static void instantiate(Fuzz *f, int slot)
{
    static char long_text[6000];
    static const char *const NAMES[] = {"a", "", NULL, "100 % %s %n", "\xc3\xb6\xff", long_text};
    const char *const places[] = {NULL, "", "file:", "file://", "file:///%zz", "file:///%00", "file://h/%41",
                                  "nowhere", "file:///dev/null", "file:///", long_text, f->bad};
    Slot *s = &f->slots[slot];
    const int sane = chance(80);
    const char *name = sane ? "fuzz" : NAMES[random_below(6)];
    const char *guid = sane || chance(80) ? f->guid : chance(50) ? "{0}" : NULL;
    const char *place = sane || chance(30) ? f->good : places[random_below(12)];
    const fmi2CallbackFunctions *callbacks = sane || chance(95) ? &FUZZ_CALLBACKS : NULL;

    memset(long_text, 'x', sizeof long_text - 1);
    fuzz_free(f, slot);
    if (place == f->bad) damage_resources(f);
    s->type = chance(60) ? fmi2CoSimulation : chance(98) ? fmi2ModelExchange : (fmi2Type)7;
    fuzz_out_of_memory = sane ? 0 : 100;
    s->c = fmi2Instantiate(name, s->type, guid, place, callbacks, fmi2False, chance(20));
    fuzz_out_of_memory = 0;
    ++f->calls;
    s->phase = s->c != NULL ? INSTANTIATED : NONE;
    if (s->c != NULL) {
        ++f->ok;
        if (guid != f->guid || place == f->bad || callbacks == NULL || name == NULL || *name == 0)
            fuzz_broken(f, "fmi2Instantiate took a wrong GUID, name or resource");
    } else {
        ++f->refused;
    }
}

static fmi2ValueReference reference(size_t count, int natural)
{
    if (count > 0 && (natural || chance(97))) return (fmi2ValueReference)random_below(count);
    return chance(50) ? (fmi2ValueReference)count : (fmi2ValueReference)random_bits();
}

typedef struct {
    size_t count, given;
    fmi2ValueReference *references;
    double *reals, *seed;
    int *integers;
    fmi2Boolean *booleans;
    fmi2String *strings;
} Arrays;

/* `given` is the count to call with; now and then a pointer is null. */
static Arrays arrays(size_t most, size_t references_below, int natural)
{
    Arrays a;
    a.count = a.given = random_below(most + 1);
    a.references = malloc(a.count * sizeof *a.references + 1);
    a.reals = malloc(a.count * sizeof(double) + 1);
    a.seed = malloc(a.count * sizeof(double) + 1);
    a.integers = malloc(a.count * sizeof(int) + 1);
    a.booleans = malloc(a.count * sizeof(fmi2Boolean) + 1);
    a.strings = malloc(a.count * sizeof(fmi2String) + 1);
    for (size_t i = 0; i < a.count; ++i) {
        a.references[i] = reference(references_below, natural);
        a.reals[i] = natural || chance(70) ? plausible() : absurd();
        a.seed[i] = a.reals[i];
        a.integers[i] = natural || chance(80) ? (int)random_below(14) - 1 : (int)random_bits();
        a.booleans[i] = natural || chance(80) ? chance(50) : (int)random_bits();
        a.strings[i] = "text";
    }
    return a;
}

static void drop(Arrays *a)
{
    free(a->references);
    free(a->reals);
    free(a->seed);
    free(a->integers);
    free(a->booleans);
    free(a->strings);
}

static void values(Fuzz *f, Slot *s, int natural)
{
    const int integers = chance(25);
    Arrays a = arrays(8, integers ? f->n_integer : f->n_real, natural && chance(s->phase >= EVENT ? 97 : 60));
    const fmi2ValueReference *r = OR_NULL(a.references);
    const int reads = s->phase != INSTANTIATED && (s->phase >= EVENT ? integers || chance(50) : chance(20));

    if (natural && !reads && !integers)
        for (size_t i = 0; i < a.count; ++i) {
            const size_t inputs = 2 * f->n_x, parameters = inputs + f->n_u + f->n_y + f->n_w;
            if (s->phase >= EVENT || chance(50)) /* inputs, else parameters */
                a.references[i] = (fmi2ValueReference)(f->n_u > 0 ? inputs + random_below(f->n_u) : f->n_real);
            else
                a.references[i] = (fmi2ValueReference)(parameters + random_below(f->n_real - parameters));
        }
    const int call = natural ? 2 * integers + !reads : (int)random_below(8);
    const size_t known = call < 2 ? f->n_real : call < 6 ? f->n_integer : 0;
    int sane = 1;
    fmi2Status status;

    for (size_t i = 0; i < a.count; ++i)
        if (a.references[i] >= known || (call == 1 && !isfinite(a.reals[i]))) sane = 0;
    switch (call) {
    case 0: status = fmi2GetReal(s->c, r, a.given, OR_NULL(a.reals)); break;
    case 1: status = fmi2SetReal(s->c, r, a.given, OR_NULL(a.reals)); break;
    case 2: status = fmi2GetInteger(s->c, r, a.given, OR_NULL(a.integers)); break;
    case 3: status = fmi2SetInteger(s->c, r, a.given, OR_NULL(a.integers)); break;
    case 4: status = fmi2GetBoolean(s->c, r, a.given, OR_NULL(a.booleans)); break;
    case 5: status = fmi2SetBoolean(s->c, r, a.given, OR_NULL(a.booleans)); break;
    case 6: status = fmi2GetString(s->c, r, a.given, OR_NULL(a.strings)); break;
    default: status = fmi2SetString(s->c, r, a.given, OR_NULL(a.strings)); break;
    }
    legal(f, s, status, call % 2 ? ~IN(BROKEN) & ~IN(ENDED) & ~IN(FAILED) : ~IN(INSTANTIATED), sane,
          "a get or set was accepted in the wrong state, of an unknown reference or with a value that is not finite");
    if (call == 0) are_finite(f, status, a.reals, a.given, "a value was read that is not finite");
    fuzz_told(f, s, status);
    drop(&a);
}

static void directional(Fuzz *f, Slot *s, int natural)
{
    Arrays known = arrays(6, f->n_x + f->n_u, natural), unknown = arrays(6, f->n_x + f->n_y, natural);

    for (size_t i = 0; i < known.count; ++i)
        if (known.references[i] >= f->n_x && known.references[i] < f->n_x + f->n_u) /* inputs lie behind derivatives */
            known.references[i] += (fmi2ValueReference)f->n_x;
    for (size_t i = 0; i < unknown.count; ++i)
        unknown.references[i] += (fmi2ValueReference)(unknown.references[i] < f->n_x ? f->n_x : f->n_x + f->n_u);
    const fmi2Status status = fmi2GetDirectionalDerivative(s->c, OR_NULL(unknown.references), unknown.given,
                                                           OR_NULL(known.references), known.given,
                                                           OR_NULL(known.seed), OR_NULL(unknown.reals));
    legal(f, s, status, COMPUTED | IN(ENDED), 1, "a directional derivative was computed in the wrong state");
    are_finite(f, status, unknown.reals, unknown.given, "a directional derivative is not finite");
    fuzz_told(f, s, status);
    drop(&known);
    drop(&unknown);
}

static void slopes(Fuzz *f, Slot *s, int natural)
{
    const int set = chance(50);
    Arrays a = arrays(4, set ? f->n_u : f->n_y, natural);

    for (size_t i = 0; i < a.count; ++i) {
        a.references[i] += (fmi2ValueReference)(2 * f->n_x + (set ? 0 : f->n_u));
        a.integers[i] = natural ? set ? 1 + (int)random_below(3) : 1 : (int)random_below(6) - 1;
    }
    const fmi2Status status =
        set ? fmi2SetRealInputDerivatives(s->c, OR_NULL(a.references), a.given, OR_NULL(a.integers), OR_NULL(a.reals))
            : fmi2GetRealOutputDerivatives(s->c, OR_NULL(a.references), a.given, OR_NULL(a.integers),
                                           OR_NULL(a.reals));
    legal(f, s, status, set ? IN(INSTANTIATED) | IN(INITIALIZATION) | IN(STEPPING) : IN(STEPPING) | IN(FAILED) | IN(ENDED),
          1, "a derivative of an input or output was accepted in the wrong state");
    are_finite(f, status, a.reals, a.given, "a derivative of an input or output is not finite");
    fuzz_told(f, s, status);
    drop(&a);
}

static void step(Fuzz *f, Slot *s, int natural)
{
    static const double STEPS[] = {0.01, 0.005, 0.02, 1e-3, 1e-6};
    double t = 0.0, h = STEPS[random_below(5)];
    fmi2Status status;

    if (s->c != NULL && s->type == fmi2CoSimulation && s->phase == STEPPING)
        fuzz_told(f, s, fmi2GetRealStatus(s->c, fmi2LastSuccessfulTime, &t));
    if (chance(2)) h = nextafter(t, INFINITY) - t; /* one ulp */
    if (random_below(20000) == 0) h = 2.0;
    if (!natural) {
        if (chance(50)) t = absurd();
        h = absurd();
        if (h > 0.05 && h < 2000.0) h = 0.05; /* long, and allowed: tried above once in a while */
    }
    status = fmi2DoStep(s->c, t, h, chance(50));
    legal(f, s, status, IN(STEPPING), isfinite(t) && isfinite(h) && h > 0.0, "a step was accepted that cannot be made");
    fuzz_told(f, s, status);
    if (status == fmi2Discard) s->phase = FAILED;
    f->steps += status == fmi2OK;
    if (status == fmi2OK)
        for (size_t i = 0; i < f->n_y; ++i) {
            const fmi2ValueReference r = (fmi2ValueReference)(2 * f->n_x + f->n_u + i);
            double y;
            if (fmi2GetReal(s->c, &r, 1, &y) != fmi2OK || !isfinite(y))
                fuzz_broken(f, "a step was accepted and an output is not finite");
        }
}

static void exchange(Fuzz *f, Slot *s, int natural)
{
    const size_t n = natural || chance(90) ? f->n_x : random_below(f->n_x + 3);
    double *x = malloc(n * sizeof(double) + 1);
    double t = natural ? fabs(plausible()) : absurd();
    fmi2EventInfo info;
    fmi2Boolean enter, end;
    fmi2Status status;

    switch (natural && s->phase == EVENT ? 8 : (int)random_below(natural ? 8 : 9)) {
    case 0:
        status = fmi2GetDerivatives(s->c, OR_NULL(x), n);
        legal(f, s, status, READ, n == f->n_x, "derivatives were read in the wrong state");
        fuzz_told(f, s, status);
        are_finite(f, status, x, n, "a derivative is not finite");
        break;
    case 1:
        status = fmi2GetContinuousStates(s->c, OR_NULL(x), n);
        legal(f, s, status, READ, n == f->n_x, "states were read in the wrong state");
        fuzz_told(f, s, status);
        are_finite(f, status, x, n, "a state is not finite");
        break;
    case 2:
        if (s->c == NULL || s->type != fmi2ModelExchange || n != f->n_x || fmi2GetContinuousStates(s->c, x, n) != fmi2OK)
            memset(x, 0, n * sizeof(double));
        for (size_t i = 0; i < n; ++i) x[i] = natural ? x[i] + 1e-3 * plausible() : chance(80) ? plausible() : absurd();
        status = fmi2SetContinuousStates(s->c, OR_NULL(x), n);
        legal(f, s, status, IN(CONTINUOUS), n == f->n_x, "states were accepted outside continuous-time mode");
        are_finite(f, status, x, n, "a state was set that is not finite");
        fuzz_told(f, s, status);
        break;
    case 3:
        status = fmi2SetTime(s->c, t);
        legal(f, s, status, IN(EVENT) | IN(CONTINUOUS), isfinite(t), "a time was accepted that is not finite, or too early");
        fuzz_told(f, s, status);
        break;
    case 4:
        status = fmi2GetNominalsOfContinuousStates(s->c, OR_NULL(x), n);
        legal(f, s, status, READ | IN(INSTANTIATED), n == f->n_x, "nominals were read in the wrong state");
        fuzz_told(f, s, status);
        break;
    case 5:
        status = fmi2GetEventIndicators(s->c, OR_NULL(x), natural ? 0 : n);
        legal(f, s, status, READ, 1, "event indicators were read in the wrong state");
        fuzz_told(f, s, status);
        break;
    case 6:
        status = fmi2CompletedIntegratorStep(s->c, fmi2True, OR_NULL(&enter), OR_NULL(&end));
        legal(f, s, status, IN(CONTINUOUS), 1, "a step was completed outside continuous-time mode");
        fuzz_told(f, s, status);
        break;
    case 7:
        status = fmi2EnterEventMode(s->c);
        legal(f, s, status, IN(CONTINUOUS), 1, "event mode was entered from the wrong state");
        if (fuzz_told(f, s, status) == fmi2OK) s->phase = EVENT;
        break;
    default:
        status = fmi2NewDiscreteStates(s->c, OR_NULL(&info));
        legal(f, s, status, IN(EVENT), 1, "events were handled outside event mode");
        f->events += fuzz_told(f, s, status) == fmi2OK;
        break;
    }
    free(x);
}

static void asking(Fuzz *f, Slot *s)
{
    const fmi2StatusKind kind = (fmi2StatusKind)((int)random_below(6) - 1);
    const int natural = 0;
    fmi2Status status;
    double real;
    int integer;
    fmi2Boolean boolean;
    fmi2String text;
    const char *categories[] = {"logAll", "logEvents", "nothing", NULL, "%s%n"};
    const size_t n = random_below(5);

    switch (random_below(7)) {
    case 0: fuzz_told(f, s, fmi2GetStatus(s->c, kind, OR_NULL(&status))); break;
    case 1: fuzz_told(f, s, fmi2GetRealStatus(s->c, kind, OR_NULL(&real))); break;
    case 2: fuzz_told(f, s, fmi2GetIntegerStatus(s->c, kind, OR_NULL(&integer))); break;
    case 3: fuzz_told(f, s, fmi2GetBooleanStatus(s->c, kind, OR_NULL(&boolean))); break;
    case 4: fuzz_told(f, s, fmi2GetStringStatus(s->c, kind, OR_NULL(&text))); break;
    case 5: fuzz_told(f, s, fmi2CancelStep(s->c)); break;
    default: fuzz_told(f, s, fmi2SetDebugLogging(s->c, chance(30), n, OR_NULL(categories + random_below(5 - n + 1)))); break;
    }
}

static void sequence(Fuzz *f, Slot *s, int natural)
{
    const int defined = chance(10);
    const double start = natural || chance(80) ? 0.0 : absurd(), stop = natural ? 20.0 : absurd();
    const unsigned live = IN(EVENT) | IN(CONTINUOUS) | IN(STEPPING) | IN(FAILED);
    static const char *const WRONG = "a call of the sequence was accepted in the wrong state";
    Phase next = s->phase;
    fmi2Status status;

    switch (natural ? (int)s->phase : (int)random_below(8)) {
    case INSTANTIATED:
        status = fmi2SetupExperiment(s->c, chance(50), absurd(), start, defined, stop);
        legal(f, s, status, IN(INSTANTIATED), isfinite(start), WRONG);
        if (fuzz_told(f, s, status) != fmi2OK) return;
        status = fmi2EnterInitializationMode(s->c);
        legal(f, s, status, IN(INSTANTIATED), 1, WRONG);
        next = INITIALIZATION;
        break;
    case INITIALIZATION:
        status = fmi2ExitInitializationMode(s->c);
        legal(f, s, status, IN(INITIALIZATION), 1, WRONG);
        next = s->type == fmi2CoSimulation ? STEPPING : EVENT;
        break;
    case EVENT:
        status = fmi2EnterContinuousTimeMode(s->c);
        legal(f, s, status, IN(EVENT), 1, WRONG);
        next = CONTINUOUS;
        break;
    case CONTINUOUS: exchange(f, s, natural); return;
    case STEPPING: step(f, s, natural); return;
    case NONE:
    case FAILED:
        status = fmi2Terminate(s->c);
        legal(f, s, status, live, 1, WRONG);
        next = ENDED;
        break;
    default:
        status = fmi2Reset(s->c);
        next = INSTANTIATED;
        break;
    }
    if (fuzz_told(f, s, status) == fmi2OK) s->phase = next;
}

/* What a master might do next with an instance in its phase. */
static void natural_call(Fuzz *f, int slot)
{
    Slot *s = &f->slots[slot];
    const size_t dice = random_below(100);

    switch (s->phase) {
    case INSTANTIATED: if (dice < 70) sequence(f, s, 1); else values(f, s, 1); break;
    case INITIALIZATION: if (dice < 50) sequence(f, s, 1); else values(f, s, 1); break;
    case EVENT: if (dice < 30) sequence(f, s, 1); else if (dice < 70) exchange(f, s, 1); else values(f, s, 1); break;
    case CONTINUOUS:
        if (dice < 60) exchange(f, s, 1);
        else if (dice < 70) directional(f, s, 1);
        else if (dice < 85) values(f, s, 1);
        else fuzz_save(f, slot, 1);
        break;
    case STEPPING:
        if (dice < 45) step(f, s, 1);
        else if (dice < 60) slopes(f, s, 1);
        else if (dice < 65) directional(f, s, 1);
        else if (dice < 85) values(f, s, 1);
        else fuzz_save(f, slot, 1);
        break;
    default: if (dice < 60) sequence(f, s, 1); else fuzz_save(f, slot, 1); break;
    }
}

void fuzz_call(Fuzz *f)
{
    const int slot = (int)random_below(SLOTS), natural = chance(93);
    Slot *s = &f->slots[slot];

    if (s->c == NULL ? chance(90) : random_below(300) == 0) {
        instantiate(f, slot);
        return;
    }
    if (natural) {
        natural_call(f, slot);
        return;
    }
    switch (random_below(8)) {
    case 0: case 1: sequence(f, s, 0); break;
    case 2: values(f, s, 0); break;
    case 3: fuzz_save(f, slot, 0); break;
    case 4: directional(f, s, 0); break;
    case 5: exchange(f, s, 0); break;
    case 6: slopes(f, s, 0); break;
    default: asking(f, s); break;
    }
}
