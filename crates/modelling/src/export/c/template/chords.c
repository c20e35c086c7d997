
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
