
/* Curve of the readout: L = a + b * p + sum of bend_i * max(p - point_i, 0). */
static const float CURVE_OFFSET = @offset@
static const float CURVE_SLOPE = @slope@
@bends@
static float bend(float linear)
{
    float value = CURVE_OFFSET + product(CURVE_SLOPE, linear);
@loop@
    return value;
}
