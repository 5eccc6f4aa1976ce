"""Forces that joints lack along a smoothed motion: where a search begins, and what two logs are compared by.

Modules import only those before them: `smoothing` makes a motion of readings, `force_space` rows of a log, `machines`
are what forces are taken about, `motions` say by what force, and `start` what it is at first sight. Where efforts were
measured, `efforts` are searched for causes and `left` is what is left of them.
"""
