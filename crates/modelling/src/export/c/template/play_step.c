static float play(float threshold, float path, float last)
{
    const float low = path - threshold;
    const float high = path + threshold;

    return (last < low) ? low : ((last > high) ? high : last);
}
