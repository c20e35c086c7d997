
/* @meaning@: a + b * x + sum of bend_i * max(x - point_i, 0). */
static const float @UPPER@_OFFSET = @offset@
static const float @UPPER@_SLOPE = @slope@
@bends@
static float @lower@(float x)
{
    float value = @UPPER@_OFFSET + product(@UPPER@_SLOPE, x);
@loop@
    return value;
}
