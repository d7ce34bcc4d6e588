//! Exported graphs give the library's results in ONNX Runtime, which also checks them, and in the modules
//! in JavaScript.
//!
//! `CAPE_ONNX_PYTHON` names a Python with the packages onnx, onnxruntime and numpy, `CAPE_NODE` a Node
//! other than the one in the path; tests whose program is missing report themselves as skipped.

mod javascript;
mod models;
mod onnxruntime;

/// Numbers of bodies that are computed together.
const BATCHES: [usize; 2] = [1, 5];
