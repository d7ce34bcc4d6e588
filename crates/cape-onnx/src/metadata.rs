//! Entries of a model's metadata.

use cape_core::{Outfit, joints::JOINT_NAMES};
use cape_infer::ClothedModel;

use crate::{OnnxModel, WeightPrecision};

/// Adds what a program needs to know of a network.
pub(crate) fn describe(
    onnx: OnnxModel,
    model: &ClothedModel,
    precision: WeightPrecision,
) -> OnnxModel {
    let outfits: Vec<&str> = model.outfits().iter().map(Outfit::name).collect();
    describe_body(onnx, precision)
        .with_entry("outfits", &outfits.join(","))
        .with_entry("latent", &model.latent().to_string())
}

/// Adds what a program needs to know of a body.
pub(crate) fn describe_body(onnx: OnnxModel, precision: WeightPrecision) -> OnnxModel {
    let stored = match precision {
        WeightPrecision::Single => "float32",
        WeightPrecision::Half => "float16",
    };
    onnx.with_entry("units", "metres, radians")
        .with_entry("coordinate_system", "right-handed, y up, the body faces +z")
        .with_entry("pose", "axis-angle of each joint relative to its parent")
        .with_entry("pose_joints", &JOINT_NAMES.join(","))
        .with_entry("weights", stored)
}
