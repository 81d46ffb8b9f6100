// The mixture code: a feature as a few atoms of a dictionary with weights.
#pragma once

#include "mixture_atoms.h"
#include "mixture_encoding.h"
#include "mixture_scan.h"
#include "mixture_best.h"

static const MixtureKernels mixture_kernels = {mixture_encode, nearest_centres, nearest_members, score_table, table_place, mixture_scores, rows_above, mixture_best, kTileQueries};
