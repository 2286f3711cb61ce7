"""Limits of a detector of wrong signals by default: those of its FMU and of `[detector]` of a scenario.

Tuned on the clean runs and the twelve kinds of wrong signals of docs/wrong_signals.md; pu of the rated
frequency.
"""

#: how a message says where the file of a detector comes from
DETECTOR_WRITER = "`python -m interarea.cosim.screen.detector_design` writes one"
INTERVAL_S = 0.02  #: between frames: 50 a second, as most PMUs send
RANGE_PU = 0.05  #: largest magnitude: 3 Hz of 60
JUMP_PU_PER_S = 0.24  #: largest change: that of a machine of H = 2.1 s that loses its whole power
REPEAT_FRAMES = 10  #: consecutive frames, equal or as earlier ones
MOVING_PU = 1e-6  #: least change between two frames of a signal that moves
APART_PU = 1e-3  #: largest distance of a mean from the median of the others
APART_SHARE = 0.75  #: of the others' span, added to that
ROUGH_PU = 1e-4  #: largest median of the second differences, plus twice that of the others
AVERAGE_S = 2.0  #: that means and spans are taken over: a period of the slowest swing, or more
RETURN_S = 60.0  #: without a failed test before a signal is trusted again
STANDING_PU = 3e-4  #: span of a swing that takes all signals out
STANDING_S = 15.0  #: duration of such a swing before it does
WAIT_S = 1.0  #: that a late signal is waited for
