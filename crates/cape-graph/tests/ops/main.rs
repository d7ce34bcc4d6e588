//! The graph operations against composed tensor operations and finite differences, on every CPU
//! device compiled in or on those of `CAPE_TEST_DEVICES=flex,wgpu:cpu`.

mod activations;
mod chebyshev;
mod fused;
mod host;
mod sparse;
mod support;
mod threads;
