//! cape-model.
