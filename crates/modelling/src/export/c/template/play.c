
/* Play operators: H = max(v - r, min(v + r, H)), with the thresholds r and the weights w of their sum s. */
#define PLAYS @plays@u
static const float PLAY_THRESHOLDS[PLAYS] = {
@thresholds@};
static const float PLAY_WEIGHTS[PLAYS] = {
@weights@};
@inputs@
