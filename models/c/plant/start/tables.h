#ifndef INTERAREA_TABLES_H
#define INTERAREA_TABLES_H
#include "../numbers/layout.h"

/* The read-only network of the record; pointers live for one call only. */
typedef struct {
    const int32_t *machine_bus, *branch_from, *branch_to, *branch_status, *load_bus;
    const double *branch, *shunt, *load;   /* B_ROWS x n_branch, 2 x n_bus, L_ROWS x n_load */
    const int32_t *item_bus, *item_status; /* switchable shunts */
    const double *item;                    /* 2 x n_item: conductance, susceptance */
    size_t n_item;
    const int32_t *places;                 /* pattern of a sparse network (sparse.h) */
    const char *bus_names, *branch_names, *machine_names;  /* one a line */
} Network;

/* Bus of a port; a machine's lies behind its air gap. */
static inline size_t port_bus(const Network *net, const double *row)
{
    const size_t of = index_at(row, P_DEVICE);

    if (port_is_load(row)) return (size_t)net->load_bus[of];
    return port_is_machine(row) ? (size_t)net->machine_bus[of] : index_at(row, P_BUS);
}

/* plant_read: the counts and the network; plant_check: every other array, by
 * its length and what it refers to; plant_tables: numbers and parameters into memory. */
BlockStatus plant_read(const Record *record, const BlockLayout *layout, Plan *plan, Network *network,
                       BlockMessage *message);
BlockStatus plant_check(const Record *record, const BlockLayout *layout, const Plan *plan, const Network *network,
                        BlockMessage *message);
BlockStatus plant_tables(Block *b, const Plan *plan, const Network *network, BlockMessage *message);
#endif
