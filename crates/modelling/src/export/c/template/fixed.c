
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
