
static const layer_parameters LAYERS[@layer_count@] = {
@layers@};

/* Dense output: N = bias + scale * sum of weight * h. */
#define HIDDEN @outputs@u
static const int16_t DENSE_WEIGHTS[HIDDEN] = {
@dense@};
static const float DENSE_SCALE = @scale@
static const float DENSE_BIAS = @bias@

static void reset_network(@name@_state *state)
{
    uint32_t unit;

@resets@}

/* One step of the network: features in Q1.14 give the correction in normalised output. */
static float step_network(@name@_state *state, const int16_t *features)
{
    int32_t sum = 0;
    uint32_t unit;

@steps@    for (unit = 0u; unit < HIDDEN; unit++) {
        sum += (int32_t)DENSE_WEIGHTS[unit] * (int32_t)@hidden@[unit];
    }
    return DENSE_BIAS + product(DENSE_SCALE, (float)sum);
}
