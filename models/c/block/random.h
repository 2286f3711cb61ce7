#ifndef INTERAREA_RANDOM_H
#define INTERAREA_RANDOM_H
/* Random numbers of packets and of noise: a hash, so that they depend on nothing but their
 * arguments: the same in every tool, for every step, after any restored state. */

/* A number in [0, 1) from seed, number (of a packet) and purpose. */
double packet_random(int seed, double packet, unsigned stream);

#endif
