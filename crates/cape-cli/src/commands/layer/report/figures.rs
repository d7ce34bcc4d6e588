//! Pictures of clothing coloured by error, beside the ground truth.

use cape_core::{Mesh, SmplModel};
use cape_layer::experiment::{ComponentCurve, ExampleFrame, LayerError, distances};
use cape_render::{Image, Plot, Series, Tile, View, contact_sheet};
use ndarray::{ArrayView2, Axis};

use super::jobs::NamedSet;
use crate::{
    commands::layer::pictures::{PictureCamera, mesh_of, shades},
    error::Result,
};

/// Height of a picture, pixels.
const HEIGHT: u32 = 300;
/// Error of the brightest colour, millimetres.
const BRIGHTEST: f64 = 30.0;

/// The ground truth, and clothing coloured by error; one camera per frame.
pub(super) fn errors(model: &SmplModel, named: &NamedSet, shown: &[ExampleFrame]) -> Result<Image> {
    let each = named.set.each_frame();
    let mut tiles = Vec::new();
    for shown in shown {
        let (sequence, frame) = each[shown.frame];
        let sequence = &named.set.sequences[sequence];
        let pose = sequence.motion.poses.row(frame).to_vec();
        let transl = [0, 1, 2].map(|axis| sequence.motion.translations[(frame, axis)]);
        let body = model.pose_shape(&sequence.shape(model)?, &pose, transl, None)?.vertices;
        let body = mesh_of(body.view(), &model.faces);
        let truth = sequence.clothing.index_axis(Axis(0), frame);
        let true_mesh = mesh_of(truth, &named.set.faces);
        let stage = PictureCamera::around([&body, &true_mesh], View::ThreeQuarter, HEIGHT)?;
        tiles.push(tile(&stage, &body, &true_mesh, truth, shown, &named.set.faces)?);
    }
    let title = format!("error from 0 to {BRIGHTEST} mm");
    Ok(contact_sheet(&tiles, tiles.len(), Some(&title))?)
}

/// Size of the plot, pixels.
const PLOT: [u32; 2] = [720, 400];

/// Errors by the number of components, logarithmic; held-out frames of a set after all of it.
pub(super) fn curves(curves: &[ComponentCurve]) -> Result<Image> {
    let series = |curve: &ComponentCurve| {
        let line = |name: String, errors: &[f64]| {
            let counts = curve.components.iter().map(|&count| count as f64);
            Series { name, points: counts.zip(errors.iter().copied()).collect() }
        };
        let held_out = format!("{}, held out", curve.set);
        [line(curve.set.clone(), &curve.own_mm), line(held_out, &curve.held_out_mm)]
    };
    let plot = Plot {
        title: String::new(),
        x_label: "number of components".into(),
        y_label: "mean error, mm".into(),
        log_y: true,
        series: curves.iter().flat_map(series).collect(),
    };
    Ok(plot.draw(PLOT[0], PLOT[1])?)
}

fn tile(
    stage: &PictureCamera,
    body: &Mesh,
    true_mesh: &Mesh,
    truth: ArrayView2<'_, f64>,
    shown: &ExampleFrame,
    faces: &[[u32; 3]],
) -> Result<Tile> {
    let Some(clothing) = &shown.clothing else {
        let image = stage.show(Some(body), true_mesh, None)?;
        return Ok(Tile { image, label: shown.label.clone() });
    };
    let mesh = mesh_of(clothing.view(), faces);
    let colours = shades(&distances(clothing.view(), truth), BRIGHTEST);
    let image = stage.show(Some(body), &mesh, Some(&colours))?;
    let mean = LayerError::between(clothing.view(), truth).mean;
    Ok(Tile { image, label: format!("{}, {mean:.1} mm", shown.label) })
}
