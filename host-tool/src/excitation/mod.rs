//! Input signals: the paper's families and the ones a lab needs, checked against the rig's limits.
