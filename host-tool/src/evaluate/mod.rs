//! Judging models: errors per file and family, the ladder, the acceptance suite.
