//! The `cape` command as its users meet it: the real binary on small data.

mod bad_data;
mod bad_places;
mod bench;
mod built_in;
mod commands;
mod download;
mod files;
mod fitting;
mod folders;
mod foreign_files;
mod layer;
mod masks;
mod motions;
mod people;
mod priors;
mod scanning;
mod support;
mod tf_writer;
mod training;
mod trials;
mod variations;
mod wardrobe;
