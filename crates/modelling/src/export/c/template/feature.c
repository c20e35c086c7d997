
/*
 * A feature in Q1.14: rounded to nearest, ties to even, and saturated. Adding 1.5 * 2^23 brings the integer into the low bits of the
 * sum. What is not a number becomes the lower bound.
 */
static int16_t quantise(float feature)
{
    union {
        float value;
        uint32_t bits;
    } sum;
    float scaled = product(feature, 16384.0f);

    scaled = (scaled > -32768.0f) ? scaled : -32768.0f;
    scaled = (scaled < 32767.0f) ? scaled : 32767.0f;
    sum.value = scaled + 12582912.0f;
    return (int16_t)((int32_t)sum.bits - (int32_t)0x4B400000);
}
