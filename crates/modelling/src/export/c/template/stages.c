@constants@
/*
 * What the operators follow, of the input behind the dead time.
 *
 *   a = supply(delay(u))    q += min(max(a - q, -fall), rise)    w += fill or vent * (q - w)    v = muscle(filter(w))
 */
static float lead(@name@_state *state, float delayed, bool first)
{
    float path = @supply@;

@stages@    return between(@muscle@, -MOST_NORMALISED, MOST_NORMALISED);
}
