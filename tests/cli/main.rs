//! The `cape` command as its users meet it: the real binary on small data.

mod bad_data;
mod bad_places;
mod bench;
mod commands;
mod support;
mod training;
