#include "outage.h"

#include "channel_variables.h"

int outage_at(const Block *b, double t, double *since)
{
    const double *window = b->p + P_OUTAGES;
    double at = t;
    int inside = 0, moved = 1;

    for (int round = 0; round < CHANNEL_OUTAGES && moved; ++round) {
        moved = 0;
        for (int k = 0; k < CHANNEL_OUTAGES; ++k) {
            const double start = window[2 * k], end = window[2 * k + 1];
            /* the first window must hold at t itself, further ones reach back from it */
            const int reaches = inside ? start < at && at <= end + TIME_SLACK
                                      : start <= t + TIME_SLACK && t < end - TIME_SLACK;
            if (reaches && end > start) {
                at = start;
                inside = moved = 1;
            }
        }
    }
    *since = at;
    return inside;
}
