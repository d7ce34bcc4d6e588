//! Pictures of errors on the body, and of reconstructions beside the ground truth.

use cape_core::{Mesh, SmplModel, smpl::ClothingMask};
use cape_data::PackedSet;
use cape_eval::{
    comparison::{MethodResults, RunErrors},
    table2::FigureFrames,
};
use cape_render::{
    Bounds, Camera, Image, Material, Object, Projection, Style, TextSize, Tile, View, colormap,
    contact_sheet, render,
};
use cape_synth::poses;
use ndarray::{Array2, Axis};

use crate::error::{Error, Result};

const PAPER: [u8; 4] = [250, 250, 251, 255];
const INK: [u8; 3] = [40, 42, 46];
/// Colour of vertices without clothing.
const BARE: [f32; 3] = [0.75; 3];
const CLAY: Material = Material { colour: [0.72, 0.71, 0.70], gloss: 0.05 };
const SIDES: [View; 2] = [View::Front, View::Back];
/// Heights of a body with errors and of a reconstruction, pixels.
const MAP_HEIGHT: u32 = 420;
const CLAY_HEIGHT: u32 = 300;
/// Width of the colour bar, pixels.
const BAR_WIDTH: u32 = 150;

/// Front and back of the body coloured by the errors of every method, with a colour bar.
pub(super) fn maps(body: &SmplModel, methods: &[MethodResults]) -> Result<Image> {
    let mesh = a_posed(body)?;
    let bounds = bounds_of([&mesh])?;
    let style = style(MAP_HEIGHT, &[bounds]);
    let maps: Vec<Vec<f32>> =
        methods.iter().map(|method| vertex_means(&method.results, mesh.vertices.len())).collect();
    let scale = scale_of(maps.iter().flatten());
    let mut tiles = Vec::new();
    for (method, errors) in methods.iter().zip(&maps) {
        let colour = |&error: &f32| if error > 0.0 { colormap(error / scale) } else { BARE };
        let colours: Vec<[f32; 3]> = errors.iter().map(colour).collect();
        let object = Object::new(&mesh).with_colours(&colours);
        let image = both_sides(object, &bounds, &style)?;
        tiles.push(Tile { image, label: method.label.clone() });
    }
    let columns = (tiles.len() as f64).sqrt().ceil() as usize;
    let sheet = contact_sheet(&tiles, columns, Some("mean error, front and back"))?;
    let mut image = Image::new(sheet.width() + BAR_WIDTH, sheet.height(), PAPER)?;
    image.draw(&sheet, 0, 0);
    draw_bar(&mut image, sheet.width(), scale);
    Ok(image)
}

/// A method's reconstructions of the frames of the figure.
pub(super) struct MethodFigure {
    pub(super) label: String,
    pub(super) frames: FigureFrames,
}

/// Frames, front and back, in a row for the ground truth and one for every method.
pub(super) fn reconstructions(
    set: &PackedSet,
    body: &SmplModel,
    mask: &ClothingMask,
    rows: &[usize],
    methods: &[MethodFigure],
) -> Result<Image> {
    let mut lines: Vec<(usize, Bounds, Vec<Mesh>)> = Vec::new();
    for (index, &row) in rows.iter().enumerate() {
        let (truth, mut pose, _) = set.frame(row)?;
        // All bodies face the camera.
        pose[..3].fill(0.0);
        let mut meshes = vec![dressed(body, mask, &pose, truth)?];
        for method in methods {
            let worn = method.frames.displacement.index_axis(Axis(0), index).mapv(f64::from);
            meshes.push(dressed(body, mask, &pose, worn)?);
        }
        lines.push((row, bounds_of(&meshes)?, meshes));
    }
    let bounds: Vec<Bounds> = lines.iter().map(|(_, bounds, _)| *bounds).collect();
    let style = style(CLAY_HEIGHT, &bounds);
    let mut tiles = Vec::new();
    for method in 0..=methods.len() {
        for (row, bounds, meshes) in &lines {
            let object = Object { material: CLAY, ..Object::new(&meshes[method]) };
            let label = match method.checked_sub(1) {
                None => format!("{}, ground truth", name_of(set, *row)),
                Some(method) => methods[method].label.clone(),
            };
            tiles.push(Tile { image: both_sides(object, bounds, &style)?, label });
        }
    }
    Ok(contact_sheet(&tiles, lines.len().max(1), None)?)
}

fn name_of(set: &PackedSet, row: usize) -> String {
    match set.origins() {
        Some(origins) => origins[row].frame.clone(),
        None => format!("{}, frame {row}", set.outfits()[row]),
    }
}

/// Front and back, side by side.
fn both_sides(object: Object, bounds: &Bounds, style: &Style) -> Result<Image> {
    let mut image = Image::new(2 * style.width, style.height, PAPER)?;
    for (side, left) in SIDES.into_iter().zip([0, style.width]) {
        image.draw(&picture(object, bounds, side, style)?, i64::from(left), 0);
    }
    Ok(image)
}

fn picture(object: Object, bounds: &Bounds, view: View, style: &Style) -> Result<Image> {
    let aspect = style.width as f32 / style.height as f32;
    let camera = Camera::framing(bounds, view, Projection::default(), aspect);
    Ok(render(&[object], &camera, style)?)
}

/// Style of pictures of this height, wide enough for all `bounds`.
fn style(height: u32, bounds: &[Bounds]) -> Style {
    let aspect = |bounds: &Bounds| {
        let size = bounds.max - bounds.min;
        size.x / size.y.max(1e-3)
    };
    let widest = bounds.iter().map(aspect).fold(0.0, f32::max).clamp(0.3, 1.5);
    Style { width: (height as f32 * widest).round() as u32, height, ..Style::default() }
}

fn bounds_of<'a>(meshes: impl IntoIterator<Item = &'a Mesh>) -> Result<Bounds> {
    Bounds::from_meshes(meshes).ok_or_else(|| Error::message("the body has no vertices"))
}

fn a_posed(body: &SmplModel) -> Result<Mesh> {
    let pose = poses::preset("a-pose").unwrap_or([0.0; 72]).map(f64::from);
    posed(body, &pose, None)
}

fn dressed(
    body: &SmplModel,
    mask: &ClothingMask,
    pose: &[f64],
    mut displacement: Array2<f64>,
) -> Result<Mesh> {
    for (mut row, covered) in displacement.rows_mut().into_iter().zip(mask.covered()) {
        if !covered {
            row.fill(0.0);
        }
    }
    posed(body, pose, Some(&displacement))
}

fn posed(body: &SmplModel, pose: &[f64], displacement: Option<&Array2<f64>>) -> Result<Mesh> {
    let vertices = body.pose(&[], pose, [0.0; 3], displacement)?.vertices;
    let vertices = vertices.rows().into_iter().map(|v| [0, 1, 2].map(|i| v[i] as f32)).collect();
    Ok(Mesh { vertices, faces: body.faces.clone() })
}

/// Mean error over seeds at every vertex.
fn vertex_means(results: &[&RunErrors], vertices: usize) -> Vec<f32> {
    let mean = |vertex: usize| {
        let errors = results.iter().filter_map(|result| result.vertex_means.get(vertex));
        errors.sum::<f32>() / results.len() as f32
    };
    (0..vertices).map(mean).collect()
}

/// Round number of millimetres above the 98th percentile of the errors.
fn scale_of<'a>(errors: impl Iterator<Item = &'a f32>) -> f32 {
    let mut sorted: Vec<f32> = errors.copied().filter(|&error| error > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let high = sorted.get(sorted.len() * 98 / 100).copied().unwrap_or(1.0);
    let rounded = [1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 75.0, 100.0];
    rounded.into_iter().find(|&round| round >= high).unwrap_or(high)
}

/// Draws the colour bar from 0 to `scale` millimetres right of column `left`.
fn draw_bar(image: &mut Image, left: u32, scale: f32) {
    let (left, right) = (i64::from(left) + 12, i64::from(left) + 48);
    let (top, bottom) = (48, i64::from(image.height().min(MAP_HEIGHT)) + 12);
    for y in top..bottom {
        let share = (bottom - 1 - y) as f32 / (bottom - 1 - top) as f32;
        let colour = colormap(share).map(|x| (255.0 * x) as u8);
        for x in left..right {
            image.blend(x, y, colour, 1.0);
        }
    }
    for quarter in 0..=4 {
        let value = scale * quarter as f32 / 4.0;
        let y = bottom - 1 - (bottom - 1 - top) * quarter / 4 - 8;
        image.text(&format!("{value:.1} mm"), right + 8, y, TextSize::Small, INK);
    }
}
