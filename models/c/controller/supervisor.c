/* A bank of linear controllers in hot standby behind a supervisor:
 *
 *     dx_i/dt = A_i x_i + B_i v,   v_j = m_j u_j          every controller runs all the time
 *     dm_j/dt = (trusted_j - m_j) / fade_time             a signal that is not trusted fades out
 *     dw_i/dt = ([i is active] - w_i) / fade_time         weights fade from the old to the active one
 *     y = min(max(sum_i w_i (C_i x_i + D_i v), -low), high)
 *
 * Without a guard (guard.h) low = high = limit. Guards watch the faded signals v;
 * they move the limits alone, so that near the equilibrium the loop is linear.
 *
 * Weights and m stay in [0, 1] and the weights sum to 1, so the loop is at every
 * instant a convex combination of the loops (controller i, signals in set S):
 * one Lyapunov function for those proves stability for every sequence of losses
 * and every fade (design/certificates/switching.py).
 *
 * A signal is no longer trusted when its flag has been down for loss_time, and
 * trusted again when it has been up for return_time. The set of trusted signals
 * chooses the active controller by the table `choice`; two switches are at least
 * dwell_time apart. Flags are looked at where a step begins.                  */
#include <math.h>
#include <stdio.h>

#include "../block/block.h"
#include "guard.h"

const int block_is_sampled = 0;

enum { MAX_SIGNALS = 6, MAX_BANK = 16 };
enum { P_LIMIT, P_FADE, P_LOSS, P_RETURN, P_DWELL, P_COUNT };
enum { IY_ACTIVE, IY_SWITCHES, IY_COUNT };
enum { M_ACTIVE, M_SWITCHED_AT, M_SWITCHES, M_SIGNALS };
/* per signal, after M_SIGNALS */
enum { S_SEEN, S_CHANGED_AT, S_TRUSTED, S_COUNT };

/* Times this close (s) are the same: masters round. */
static const double SLACK = 1e-9;

typedef struct {
    size_t n, signals, actuators, states; /* controllers; their states in all */
    const int32_t *orders, *choice;
    const double *A, *B, *C, *D;          /* one controller after the other, rows first */
} Bank;

/* Whether every entry lies in 0 to `most`. */
static int within(const int32_t *entries, size_t count, size_t most)
{
    for (size_t k = 0; k < count; ++k)
        if (entries[k] < 0 || (size_t)entries[k] > most) return 0;
    return 1;
}

static int complete(const Bank *bank)
{
    return bank->orders != NULL && bank->choice != NULL && bank->A != NULL && bank->B != NULL && bank->C != NULL
           && bank->D != NULL;
}

static int bank_of(const Record *record, const BlockLayout *layout, Bank *bank)
{
    size_t n_orders, n_choice, n_A, n_B, n_C, n_D, squares = 0;

    bank->orders = record_i32(record, "orders", &n_orders);
    bank->choice = record_i32(record, "choice", &n_choice);
    bank->A = record_f64(record, "A", &n_A);
    bank->B = record_f64(record, "B", &n_B);
    bank->C = record_f64(record, "C", &n_C);
    bank->D = record_f64(record, "D", &n_D);
    bank->n = n_orders;
    bank->signals = layout->n_u;
    bank->actuators = layout->n_y;
    bank->states = 0;
    if (!complete(bank) || n_orders < 1 || n_orders > MAX_BANK || bank->signals < 1
        || bank->signals > MAX_SIGNALS || n_choice != (size_t)1 << bank->signals)
        return 0;
    if (!within(bank->orders, n_orders, 1000) || !within(bank->choice, n_choice, n_orders - 1)) return 0;
    for (size_t i = 0; i < n_orders; ++i) {
        bank->states += (size_t)bank->orders[i];
        squares += (size_t)bank->orders[i] * (size_t)bank->orders[i];
    }
    return n_A == squares && n_B == bank->states * bank->signals && n_C == bank->actuators * bank->states
           && n_D == n_orders * bank->actuators * bank->signals;
}

BlockStatus block_needs(const Record *record, const BlockLayout *n, BlockNeeds *needs, BlockMessage *message)
{
    Bank bank;
    const size_t guards = guards_of(record, n->n_y, n->n_u).guards;

    if (!bank_of(record, n, &bank) || n->n_x != bank.states + bank.n + bank.signals + 2 * guards
        || n->n_p != P_COUNT + (guards > 0 ? guards + 3 : 0)
        || n->n_iu != bank.signals || n->n_iy != IY_COUNT || n->n_w + n->n_iw + n->n_ip > 0) {
        snprintf(message->text, sizeof message->text,
                 "supervisor: the variables do not match the bank in the record");
        return BLOCK_ERROR;
    }
    needs->n_memory = M_SIGNALS + S_COUNT * bank.signals;
    needs->n_scratch = 2 * bank.signals + bank.actuators;
    return BLOCK_OK;
}

static Guards guards(const Block *b)
{
    Guards g = guards_of(b->record, b->layout.n_y, b->layout.n_u);

    guards_set(&g, b->p + P_COUNT);
    return g;
}

static double *signal_memory(const Block *b, size_t j)
{
    return b->memory + M_SIGNALS + S_COUNT * j;
}

static int32_t required_member(const Block *b, const Bank *bank)
{
    size_t set = 0;

    for (size_t j = 0; j < bank->signals; ++j)
        if (signal_memory(b, j)[S_TRUSTED] > 0.0) set |= (size_t)1 << j;
    return bank->choice[set];
}

/* Weights and masks at their targets, nothing fading. */
static void settle(const Block *b, const Bank *bank, double *x)
{
    for (size_t i = 0; i < bank->n; ++i) x[bank->states + i] = (double)i == b->memory[M_ACTIVE] ? 1.0 : 0.0;
    for (size_t j = 0; j < bank->signals; ++j)
        x[bank->states + bank->n + j] = signal_memory(b, j)[S_TRUSTED];
}

static void tell(const Block *b)
{
    b->iy[IY_ACTIVE] = 1 + (int)b->memory[M_ACTIVE];
    b->iy[IY_SWITCHES] = (int)b->memory[M_SWITCHES];
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    static const char *const names[P_COUNT] = {"limit", "fade_time", "loss_time", "return_time", "dwell_time"};
    const Guards g = guards(b);
    Bank bank;

    if (!guards_can_act(&g)) {
        snprintf(message->text, sizeof message->text,
                 "supervisor: guard_threshold is %g, guard_washout %g, guard_lowpass %g; all must be positive",
                 g.threshold, g.washout, g.lowpass);
        return BLOCK_ERROR;
    }
    for (int k = 0; k < P_COUNT; ++k)
        if (!(k == P_LIMIT ? b->p[k] > 0.0 : b->p[k] >= 0.0)) {
            snprintf(message->text, sizeof message->text, "supervisor: %s is %g, it must %s", names[k], b->p[k],
                     k == P_LIMIT ? "be positive" : "not be negative");
            return BLOCK_ERROR;
        }
    (void)bank_of(b->record, &b->layout, &bank);
    for (size_t j = 0; j < bank.signals; ++j) {
        double *s = signal_memory(b, j);
        s[S_SEEN] = s[S_TRUSTED] = b->iu[j] != 0 ? 1.0 : 0.0;
        s[S_CHANGED_AT] = t;
    }
    b->memory[M_ACTIVE] = (double)required_member(b, &bank);
    b->memory[M_SWITCHED_AT] = t;
    b->memory[M_SWITCHES] = 0.0;
    settle(b, &bank, b->x);
    tell(b);
    return BLOCK_OK;
}

static double due(const Block *b, const double *s)
{
    return s[S_CHANGED_AT] + b->p[s[S_SEEN] > 0.0 ? P_RETURN : P_LOSS];
}

double block_next_event(const Block *b, double t)
{
    Bank bank;
    double next = INFINITY;

    (void)bank_of(b->record, &b->layout, &bank);
    for (size_t j = 0; j < bank.signals; ++j) {
        const double *s = signal_memory(b, j);
        if ((b->iu[j] != 0) != (s[S_SEEN] > 0.0)) return nextafter(t, INFINITY);
        if (s[S_SEEN] != s[S_TRUSTED]) next = fmin(next, due(b, s));
    }
    if ((double)required_member(b, &bank) != b->memory[M_ACTIVE])
        next = fmin(next, b->memory[M_SWITCHED_AT] + b->p[P_DWELL]);
    return next > t ? next : nextafter(t, INFINITY);
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    Bank bank;
    int32_t choice;

    (void)message;
    (void)bank_of(b->record, &b->layout, &bank);
    for (size_t j = 0; j < bank.signals; ++j) {
        double *s = signal_memory(b, j);
        const double flag = b->iu[j] != 0 ? 1.0 : 0.0;
        if (flag != s[S_SEEN]) {
            s[S_SEEN] = flag;
            s[S_CHANGED_AT] = t;
        }
        if (s[S_SEEN] != s[S_TRUSTED] && t >= due(b, s) - SLACK) s[S_TRUSTED] = s[S_SEEN];
    }
    choice = required_member(b, &bank);
    if ((double)choice != b->memory[M_ACTIVE]
        && (b->memory[M_SWITCHES] == 0.0 || t >= b->memory[M_SWITCHED_AT] + b->p[P_DWELL] - SLACK)) {
        b->memory[M_ACTIVE] = (double)choice;
        b->memory[M_SWITCHED_AT] = t;
        b->memory[M_SWITCHES] += 1.0;
    }
    if (!(b->p[P_FADE] > 0.0)) settle(b, &bank, x);
    tell(b);
    return BLOCK_OK;
}

/* sum_j M[j] v[j] of one row */
static double row(const double *M, const double *v, size_t n)
{
    double sum = 0.0;

    for (size_t j = 0; j < n; ++j) sum += M[j] * v[j];
    return sum;
}

/* dx of every controller of the bank for states x and faded signals v. */
static void bank_derivatives(const Bank *bank, const double *x, const double *v, double *dx)
{
    const double *A = bank->A, *B = bank->B;

    for (size_t i = 0; i < bank->n; ++i) {
        const size_t n = (size_t)bank->orders[i];
        for (size_t k = 0; k < n; ++k, A += n, B += bank->signals)
            dx[k] = row(A, x, n) + row(B, v, bank->signals);
        x += n;
        dx += n;
    }
}

/* y += sum_i w_i (C_i x_i + D_i v) */
static void add_outputs(const Bank *bank, const double *w, const double *x, const double *v, double *y)
{
    const double *C = bank->C, *D = bank->D;

    for (size_t i = 0; i < bank->n; ++i) {
        const size_t n = (size_t)bank->orders[i];
        for (size_t k = 0; k < bank->actuators; ++k, C += n, D += bank->signals)
            y[k] += w[i] * (row(C, x, n) + row(D, v, bank->signals));
        x += n;
    }
}

static void faded(const Bank *bank, const double *x, const double *u, double *v)
{
    for (size_t j = 0; j < bank->signals; ++j) v[j] = x[bank->states + bank->n + j] * u[j];
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    Bank bank;
    const double fade = b->p[P_FADE];
    const Guards g = guards(b);

    (void)t, (void)message;
    (void)bank_of(b->record, &b->layout, &bank);
    faded(&bank, x, u, b->scratch);
    bank_derivatives(&bank, x, b->scratch, dx);
    for (size_t i = 0, k = b->layout.n_x - 2 * g.guards; k < b->layout.n_x; ++i) {
        if (!guards_watch(&g, i)) continue;
        const Swing s = guards_swing(&g, x + k, guards_seen(&g, i, b->scratch));
        guards_derivatives(&g, s.fast, s.slow, dx + k);
        k += 2;
    }
    for (size_t i = 0; i < bank.n; ++i) {
        const double target = (double)i == b->memory[M_ACTIVE] ? 1.0 : 0.0;
        dx[bank.states + i] = fade > 0.0 ? (target - x[bank.states + i]) / fade : 0.0;
    }
    for (size_t j = 0; j < bank.signals; ++j) {
        const size_t k = bank.states + bank.n + j;
        dx[k] = fade > 0.0 ? (signal_memory(b, j)[S_TRUSTED] - x[k]) / fade : 0.0;
    }
    return BLOCK_OK;
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y,
                          BlockMessage *message)
{
    Bank bank;
    const Guards g = guards(b);

    (void)t, (void)message;
    (void)bank_of(b->record, &b->layout, &bank);
    faded(&bank, x, u, b->scratch);
    for (size_t k = 0; k < bank.actuators; ++k) y[k] = 0.0;
    add_outputs(&bank, x + bank.states, x, b->scratch, y);
    for (size_t i = 0, k = 0; i < bank.actuators; ++i) {
        double high = b->p[P_LIMIT], low = high;
        if (guards_watch(&g, i)) {
            const double *own = x + b->layout.n_x - 2 * (g.guards - k);
            const Swing s = guards_swing(&g, own, guards_seen(&g, i, b->scratch));
            high *= 1.0 - fmax(s.share * g.side[k], 0.0);
            low *= 1.0 + fmin(s.share * g.side[k], 0.0);
            ++k;
        }
        y[i] = y[i] > high ? high : y[i] < -low ? -low : y[i];
    }
    tell(b);
    return BLOCK_OK;
}

/* vy of a limited output is that of its limit; vdx of the guards. v, vv: faded signals and their direction. */
static void guard_directional(Block *b, const double *x, const double *vx, const double *v, const double *vv,
                              const double *y, double *vdx, double *vy)
{
    const Guards g = guards(b);
    const double limit = b->p[P_LIMIT];

    for (size_t i = 0, k = 0; i < b->layout.n_y; ++i) {
        double high = limit, low = limit, slope = 0.0;
        if (guards_watch(&g, i)) {
            const size_t own = b->layout.n_x - 2 * (g.guards - k);
            const Swing s = guards_swing(&g, x + own, guards_seen(&g, i, v));
            const double vfast = guards_seen(&g, i, vv) - vx[own], vslow = vx[own + 1];
            if (vdx != NULL) guards_derivatives(&g, vfast, vslow, vdx + own);
            slope = guards_slope(&g, &s, k, limit, 1.0, vfast, vslow, 0.0);
            high *= 1.0 - fmax(s.share * g.side[k], 0.0);
            low *= 1.0 + fmin(s.share * g.side[k], 0.0);
            ++k;
        }
        if (vy == NULL) continue;
        if (y[i] > high) vy[i] = high < limit ? slope : 0.0;
        else if (y[i] < -low) vy[i] = low < limit ? -slope : 0.0;
    }
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    Bank bank;
    double *v = b->scratch, *vv = v + b->layout.n_u, *y = vv + b->layout.n_u;
    const double fade = b->p[P_FADE];
    size_t masks;

    (void)t, (void)message;
    (void)bank_of(b->record, &b->layout, &bank);
    masks = bank.states + bank.n;
    faded(&bank, x, u, v);
    for (size_t j = 0; j < bank.signals; ++j) vv[j] = vx[masks + j] * u[j] + x[masks + j] * vu[j];
    if (vy != NULL) {
        for (size_t k = 0; k < bank.actuators; ++k) y[k] = vy[k] = 0.0;
        add_outputs(&bank, x + bank.states, x, v, y);
        add_outputs(&bank, vx + bank.states, x, v, vy);
        add_outputs(&bank, x + bank.states, vx, vv, vy);
    }
    if (vdx != NULL) {
        bank_derivatives(&bank, vx, vv, vdx);
        for (size_t k = bank.states; k < masks + bank.signals; ++k) vdx[k] = fade > 0.0 ? -vx[k] / fade : 0.0;
    }
    guard_directional(b, x, vx, v, vv, y, vdx, vy);
    return BLOCK_OK;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    (void)b, (void)t, (void)h, (void)u_poly, (void)dy;
    snprintf(message->text, sizeof message->text, "supervisor: not a sampled block");
    return BLOCK_ERROR;
}
