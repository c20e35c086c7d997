
/*
 * y += momentum * (y - y before) + sum of gain_i * (x i samples ago - y). The memory holds the last two outputs, then the last
 * two inputs, newest first.
 */
static float filter(float momentum, const float *gains, float *memory, float input, bool first)
{
    float moved;

    if (first) {
        memory[0] = input;
        memory[1] = input;
        memory[2] = input;
        memory[3] = input;
    }
    moved = product(momentum, memory[0] - memory[1]) + product(gains[0], input - memory[0]) +
            product(gains[1], memory[2] - memory[0]) + product(gains[2], memory[3] - memory[0]);
    memory[1] = memory[0];
    memory[0] = memory[0] + moved;
    memory[3] = memory[2];
    memory[2] = input;
    return memory[0];
}
