    uint32_t index;

    for (index = 0u; index < @UPPER@_BENDS; index++) {
        const float beyond = x - @UPPER@_POINTS[index];

        if (beyond > 0.0f) {
            value = value + product(@UPPER@_CHANGES[index], beyond);
        }
    }
