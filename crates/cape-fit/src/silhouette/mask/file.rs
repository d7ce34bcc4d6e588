//! Mask files: PNG, JPEG and NumPy arrays.

use std::{collections::BTreeMap, path::Path};

use cape_core::npy::{Npz, read_f64};
use cape_render::{ImageFile, ImageFormat, MAX_SIDE};
use ndarray::{ArrayD, Axis};

use super::{
    Mask,
    values::{MaskLabel, ValueImage},
};
use crate::{Error, Result};

/// Largest difference of the channels of a grey pixel.
const GREY: u8 = 2;
/// The same with compression noise, and the share of pixels that must be grey.
const NOISY_GREY: u8 = 48;
const GREY_PIXELS: f64 = 0.999;
/// Names of the mask in an archive of several arrays.
const NAMES: [&str; 6] = ["mask", "masks", "segmentation", "seg", "silhouette", "arr_0"];

/// Reads a mask from PNG (any colour type and depth), JPEG, `.npy` or `.npz`.
///
/// In images with transparent pixels the opaque ones are the mask. Otherwise an image of two values
/// is a mask of the brighter one; one of nearly black and nearly white pixels (soft edges,
/// compression noise) of those above half of the largest value. Of a label image `labels` are the
/// mask. Arrays are `[h, w]` or `[1, h, w]`.
///
/// # Errors
/// If the file is not readable, or is a photograph or a label image without `labels`: the message
/// lists the labels.
pub(super) fn read_mask(path: &Path, labels: &[MaskLabel]) -> Result<Mask> {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    let image = match extension.to_str() {
        Some("npy") => from_array(path, None, &read_f64(path)?)?,
        Some("npz") => {
            let mut file = Npz::open(path)?;
            let names = file.names();
            let known = || NAMES.iter().find(|name| names.iter().any(|n| n == *name));
            let name = match names.as_slice() {
                [only] => only.clone(),
                _ => known().map(ToString::to_string).ok_or_else(|| {
                    let message = format!("arrays {}, expected `mask`", names.join(", "));
                    Error::format(path, message)
                })?,
            };
            let array = file.f64(&name)?;
            from_array(path, Some(&name), &array)?
        }
        _ => match of_image(&ImageFile::read(path)?, labels.is_empty()) {
            ImageContent::Mask(mask) => return mask,
            ImageContent::Values(values) => values,
        },
    };
    image.mask(labels).map_err(|reason| Error::format(path, reason))
}

enum ImageContent {
    Mask(Result<Mask>),
    Values(ValueImage),
}

/// The mask of a cut-out, if `cut_outs` are looked for, else the values of the image.
fn of_image(file: &ImageFile, cut_outs: bool) -> ImageContent {
    let (width, height) = (file.width(), file.height());
    if let Some(opacity) = file.opacity().filter(|o| cut_outs && o.iter().any(|&a| a <= 127)) {
        let covered = opacity.iter().map(|&alpha| alpha > 127).collect();
        return ImageContent::Mask(Mask::new(width, height, covered));
    }
    let noisy = file.format() == ImageFormat::Jpeg;
    let image = |values, largest, colours, coloured| {
        ImageContent::Values(ValueImage {
            width,
            height,
            values,
            largest,
            colours,
            coloured,
            noisy,
        })
    };
    let raw = || file.samples().chunks_exact(file.channels()).map(|p| u32::from(p[0])).collect();
    let colours = file.colours();
    let spread = |&[r, g, b]: &[u8; 3]| r.max(g).max(b) - r.min(g).min(b);
    let limit = if noisy { NOISY_GREY } else { GREY };
    let grey = colours.iter().filter(|colour| spread(colour) <= limit).count();
    let grey = grey as f64 >= if noisy { GREY_PIXELS } else { 1.0 } * colours.len() as f64;
    if let Some(palette) = file.palette() {
        let table = palette.iter().enumerate().map(|(at, &[r, g, b, _])| (at as u32, [r, g, b]));
        let indices: Vec<u32> = raw();
        // Palettes of many greys are those of programs that reduce colours.
        let ramp = grey && colours.iter().any(|c| c[0] > 127) && distinct(&indices) > 2;
        if !ramp {
            return image(indices, palette.len() as u32, Some(table.collect()), false);
        }
    }
    if file.palette().is_none() && file.channels() <= 2 {
        return image(raw(), u32::from(file.largest()), None, false);
    }
    if grey {
        let values = colours.iter().map(|&[r, g, b]| u32::from(r.max(g).max(b))).collect();
        return image(values, 255, None, false);
    }
    let values: Vec<u32> = colours.iter().map(|&colour| MaskLabel::Colour(colour).into()).collect();
    let table = values.iter().copied().zip(colours.iter().copied()).collect::<BTreeMap<_, _>>();
    image(values, 0x00ff_ffff, Some(table), true)
}

fn distinct(values: &[u32]) -> usize {
    values.iter().collect::<std::collections::BTreeSet<_>>().len()
}

/// Values of an array `[h, w]`, with axes of length 1 in front or behind.
fn from_array(path: &Path, name: Option<&str>, array: &ArrayD<f64>) -> Result<ValueImage> {
    let refuse = |message: String| match name {
        Some(name) => Error::field(path, name, message),
        None => Error::format(path, message),
    };
    let shape = array.shape().to_vec();
    let mut view = array.view();
    while view.ndim() > 2 && view.shape()[0] == 1 {
        view = view.index_axis_move(Axis(0), 0);
    }
    while view.ndim() > 2 && view.shape()[view.ndim() - 1] == 1 {
        let last = Axis(view.ndim() - 1);
        view = view.index_axis_move(last, 0);
    }
    let &[height, width] = view.shape() else {
        let hint = match shape.as_slice() {
            [many, _, _] => format!(": masks of {many}? save that of one person"),
            _ => String::new(),
        };
        return Err(refuse(format!("shape {shape:?}, expected [height, width]{hint}")));
    };
    let side = MAX_SIDE as usize;
    if width == 0 || height == 0 || width > side || height > side {
        return Err(refuse(format!("shape {shape:?}, expected sides of 1 to {side}")));
    }
    if let Some(value) = view.iter().find(|value| !(**value >= 0.0 && **value <= 4e9)) {
        return Err(refuse(format!("value {value}, expected 0 or more")));
    }
    let most = view.iter().copied().fold(0.0, f64::max);
    let whole = view.iter().all(|value| value.fract() == 0.0);
    // Probabilities.
    let scale = if whole { 1.0 } else { 65535.0 / most.max(1.0) };
    let largest = match (whole, most) {
        (true, ..=255.0) => 255,
        (true, 65536.0..) => most as u32,
        _ => 65535,
    };
    Ok(ValueImage {
        width: width as u32,
        height: height as u32,
        values: view.iter().map(|value| (value * scale).round() as u32).collect(),
        largest,
        colours: None,
        coloured: false,
        noisy: false,
    })
}
