#ifndef COOPQP_ROUNDED_H
#define COOPQP_ROUNDED_H

#include "spans.h"

/* rounded(poses, deviations, settings, s, rows, motion): samples of lines between poses (M, 12) whose corners are rounded
 * off with deviations (M − 2); settings: the longest step [m], and how many a piece has at least. Returns how many there
 * are, and fills s, rows (12 each) and the motion to each but the first (2) if they have room. */
ptrdiff_t rounded(Read poses, Read deviations, Read settings, Write s, Write rows, Write motion);

#endif
