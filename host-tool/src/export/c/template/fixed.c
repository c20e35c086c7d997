
/*
 * Fixed point. Qm.n is an integer of 1 + m + n bits that stands for its value times 2^-n. Nothing below overflows: the exporter
 * has checked the bounds of every weight, scale and bias. No negative number is shifted, which C leaves to the compiler.
 */

/* floor(value / 2^bits) */
static int64_t shift_right_64(int64_t value, uint32_t bits)
{
    return (value >= 0) ? (value >> bits) : (-1 - ((-1 - value) >> bits));
}

/* floor(value / 2^bits) */
static int32_t shift_right(int32_t value, uint32_t bits)
{
    return (value >= 0) ? (value >> bits) : (-1 - ((-1 - value) >> bits));
}

static int32_t power_of_two(uint32_t exponent)
{
    return (int32_t)((uint32_t)1u << exponent);
}

static int32_t clamp(int32_t value, int32_t low, int32_t high)
{
    return (value < low) ? low : ((value > high) ? high : value);
}

/* The upper 32 of 64 bits. */
static int32_t upper(int64_t value)
{
    return (int32_t)shift_right_64(value, 32u);
}

/* The upper 32 bits of the product, rounded to nearest. */
static int32_t multiply_high(int32_t left, int32_t right)
{
    return upper(((int64_t)left * right) + INT64_C(0x80000000));
}

/* A curve as 512 chords, each with its base and its slope. */
#define SEGMENTS 512
typedef int32_t chord_table[SEGMENTS][2];

static int32_t interpolate(const int32_t table[SEGMENTS][2], int32_t argument, uint32_t step_bits)
{
    const int32_t segment = shift_right(argument, step_bits);
    const int32_t rest = argument - (segment * power_of_two(step_bits));
    const int32_t *chord = table[segment + (SEGMENTS / 2)];

    return chord[0] + (int32_t)shift_right_64((int64_t)chord[1] * rest, 16u);
}

/* Sigmoid in Q0.31 from -16 to 16: 1 / (1 + exp(-z)). */
static const chord_table SIGMOID = {
@sigmoid@};

/* Sigmoid of z in Q15.16. */
static int32_t sigmoid(int32_t z)
{
    return interpolate(SIGMOID, clamp(z, -1048576, 1048575), 12u);
}
