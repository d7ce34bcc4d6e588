//! Errors drawn on the body.

use cape_core::SmplModel;
use cape_render::{Image, Object, Style, TextSize, Tile, View, colour_of, contact_sheet, portrait};
use cape_train::table2::{Grid, Row, RowResult};

use crate::error::Result;

const INK: [u8; 3] = [40, 42, 46];

/// Front and back of the body for every method, in one scale, with its bar.
pub(super) fn maps(grid: &Grid, results: &[RowResult]) -> Result<Image> {
    let body = SmplModel::load(grid.body_path())?;
    let mesh = body.mesh();
    let mut rows: Vec<(Row, Vec<f32>)> = Vec::new();
    for row in Row::ALL {
        let of: Vec<&RowResult> = results.iter().filter(|result| result.row == row).collect();
        if of.is_empty() {
            continue;
        }
        let mean = |vertex: usize| {
            of.iter().filter_map(|result| result.vertex_means.get(vertex)).sum::<f32>()
                / of.len() as f32
        };
        rows.push((row, (0..mesh.vertices.len()).map(mean).collect()));
    }
    let scale = scale_of(rows.iter().flat_map(|(_, errors)| errors));
    let style = Style { width: 260, height: 420, ..Style::default() };
    let mut tiles = Vec::new();
    for (row, errors) in &rows {
        let colours: Vec<[f32; 3]> = errors
            .iter()
            .map(|&error| if error > 0.0 { colour_of(error / scale) } else { [0.75; 3] })
            .collect();
        for (view, side) in [(View::Front, "front"), (View::Back, "back")] {
            let image = portrait(Object::new(&mesh).coloured(&colours), view, &style)?;
            tiles.push(Tile { image, label: format!("{}, {side}", row.label()) });
        }
    }
    tiles.push(Tile { image: bar(scale, style.width, style.height)?, label: String::new() });
    Ok(contact_sheet(&tiles, 6, Some("mean error, mm"))?)
}

/// A round number of millimetres that nearly all errors are below.
fn scale_of<'a>(errors: impl Iterator<Item = &'a f32>) -> f32 {
    let mut sorted: Vec<f32> = errors.copied().filter(|&error| error > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let high = sorted.get(sorted.len() * 98 / 100).copied().unwrap_or(1.0);
    let rounded = [1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 75.0, 100.0];
    rounded.into_iter().find(|&round| round >= high).unwrap_or(high)
}

/// Colours from 0 to `scale` millimetres.
fn bar(scale: f32, width: u32, height: u32) -> Result<Image> {
    let mut image = Image::new(width, height, [250, 250, 251, 255])?;
    let (top, bottom, left, right) = (30i64, i64::from(height) - 30, 60i64, 100i64);
    for y in top..bottom {
        let share = (bottom - 1 - y) as f32 / (bottom - 1 - top) as f32;
        let colour = colour_of(share).map(|x| (255.0 * x) as u8);
        for x in left..right {
            image.blend(x, y, colour, 1.0);
        }
    }
    for quarter in 0..=4 {
        let value = scale * quarter as f32 / 4.0;
        let y = bottom - 1 - (bottom - 1 - top) * quarter / 4 - 8;
        image.text(&format!("{value:.1} mm"), right + 8, y, TextSize::Small, INK);
    }
    Ok(image)
}
