
/* Creep filters of the play sum: C += k * (s - C), with the coefficients k and the weights q. */
#define CREEPS @creeps@u
static const float CREEP_COEFFICIENTS[CREEPS] = {
@coefficients@};
static const float CREEP_WEIGHTS[CREEPS] = {
@weights@};
