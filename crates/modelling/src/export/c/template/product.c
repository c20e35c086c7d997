
/* The upper 32 bits of the product, rounded to nearest. */
static int32_t multiply_high(int32_t left, int32_t right)
{
    return upper(((int64_t)left * right) + INT64_C(0x80000000));
}
