
#ifdef @NAME@_SELF_TEST

#define SELF_TEST_SAMPLES @samples@u

static const float SELF_TEST_INPUT[SELF_TEST_SAMPLES * INPUTS] = {
@input@};

/* What the firmware gives. */
static const float SELF_TEST_OUTPUT[SELF_TEST_SAMPLES] = {
@output@};

static uint32_t bits_of(float number)
{
    union {
        float value;
        uint32_t bits;
    } both;

    both.value = number;
    return both.bits;
}

int @name@_self_test(void)
{
    @name@_state state;
    uint32_t sample;
    int first_wrong = 0;

    @name@_reset(&state);
    for (sample = 0u; sample < SELF_TEST_SAMPLES; sample++) {
        const float output = @name@_step(&state, @input_of_sample@);

        if ((first_wrong == 0) && (bits_of(output) != bits_of(SELF_TEST_OUTPUT[sample]))) {
            first_wrong = (int)sample + 1;
        }
    }
    return first_wrong;
}

#endif
