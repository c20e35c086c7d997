
/* How thresholds grow: with the path, apart with its powers, with a law of the size of its steps. */
static const float GROWTH_RISING = @rising@
static const float GROWTH_FALLING = @falling@
static const float APART[3] = {
@apart@};
static const float GROWTH_SHARE = @share@
static const float GROWTH_EXTRA = @extra@
static const float GROWTH_FADING = @fading@
static float not_negative(float value)
{
    return (value > 0.0f) ? value : 0.0f;
}
