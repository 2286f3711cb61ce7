"""How many of something a block has room for, as the headers in models/c have it."""

SIGNAL_FAULTS = 4  #: faults of a signal in a channel (signal_fault.h)
REPLAYED = 1024  #: packets that a replay can repeat (signal_fault.h)
OUTAGES = 8  #: outage windows of a channel (channel_variables.h)
QUANTILES = 33  #: points of a latency distribution, at probabilities 0, 1/32, ..., 1 (channel_variables.h)
MOST_SIGNALS = 32  #: of one concentrator
