//! cape-render.
