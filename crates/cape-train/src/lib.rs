//! cape-train.
