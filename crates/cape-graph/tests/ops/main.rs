//! Graph operations compared with composed tensor operations and finite differences, on every CPU
//! device that is compiled in, or on the devices of `CAPE_TEST_DEVICES=flex,wgpu:cpu`.

mod activations;
mod chebyshev;
mod fused;
mod host;
mod precision;
mod sparse;
mod steps;
mod support;
mod threads;
