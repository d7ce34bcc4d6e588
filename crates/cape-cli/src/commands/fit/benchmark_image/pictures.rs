use std::path::Path;

use cape_fit::{
    benchmark::{Benchmark, BenchmarkCase, Scene},
    silhouette::render,
};
use cape_infer::write_json;
use cape_render::{Image, Plot, Series, Tile, colormap, contact_sheet};
use glam::DVec3;

use crate::{commands::fit::drawing, error::Result, files};

/// Side of a tile's image before it is cut to the person, pixels at most.
const SIDE: u32 = 384;
/// Distance of the brightest colour, metres.
const FAR: f64 = 0.1;

/// Best, median and worst case by the error of the clothed body.
pub(super) fn chosen(cases: &[BenchmarkCase]) -> Vec<(&'static str, &BenchmarkCase)> {
    let mut order: Vec<&BenchmarkCase> = cases.iter().collect();
    order.sort_by(|a, b| a.clothed.squared.total_cmp(&b.clothed.squared));
    let last = order.len().saturating_sub(1);
    let mut places = vec![("best", 0), ("median", last / 2), ("worst", last)];
    places.dedup_by_key(|(_, place)| *place);
    let places = places.into_iter();
    places.filter_map(|(name, place)| Some((name, *order.get(place)?))).collect()
}

/// A row per chosen case: silhouette, keypoints, SMPLify and CAPE coloured by distance from the ground
/// truth, and the ground truth.
pub(super) fn sheet(benchmark: &Benchmark<'_>, chosen: &[(&str, &BenchmarkCase)]) -> Result<Image> {
    let mut tiles = Vec::new();
    for (name, case) in chosen {
        tiles.extend(row(benchmark, name, case)?);
    }
    let title = format!("distance from the ground truth: dark 0, bright {:.0} mm", 1000.0 * FAR);
    Ok(contact_sheet(&tiles, 5, Some(&title))?)
}

/// Writes inputs for `cape fit image`: keypoints.json, mask.png, and the ground truth as image.png.
pub(super) fn inputs(benchmark: &Benchmark<'_>, directory: &Path, case: &BenchmarkCase) -> Result {
    let Scene { camera, keypoints, mask, truth } = benchmark.scene(case.frame)?;
    files::create_dir(directory)?;
    write_json(&directory.join("keypoints.json"), &keypoints.to_openpose())?;
    mask.to_image()?.save(directory.join("mask.png"))?;
    let mut image = drawing::paper(&camera)?;
    drawing::body(&mut image, &truth, benchmark.faces(), None, &camera)?;
    Ok(image.save(directory.join("image.png"))?)
}

fn row(benchmark: &Benchmark<'_>, name: &str, case: &BenchmarkCase) -> Result<[Tile; 5]> {
    let Scene { camera, keypoints, mask, truth } = benchmark.scene(case.frame)?;
    let [bare, clothed] = benchmark.surfaces(case)?;
    let faces = benchmark.faces();
    let small = camera.downscaled_to(SIDE);
    let mut masks = Vec::new();
    for vertices in [&truth, &bare, &clothed] {
        masks.push(render(vertices, faces, &small)?.mask().clone());
    }
    let person = drawing::person_box(&masks).unwrap_or([0, 0, small.width(), small.height()]);
    let shown = |vertices: &[DVec3], colours: Option<&[[f32; 3]]>| {
        let mut picture = drawing::paper(&small)?;
        drawing::body(&mut picture, vertices, faces, colours, &small)?;
        drawing::cut(&picture, person)
    };
    let errors = |vertices: &[DVec3]| -> Result<Vec<[f32; 3]>> {
        let alignment = cape_fit::Alignment::between(vertices, &truth)?;
        let off = vertices.iter().zip(&truth).map(|(v, t)| alignment.apply(*v).distance(*t));
        Ok(off.map(|distance| colormap((distance / FAR) as f32)).collect())
    };
    let mut silhouette = drawing::paper(&small)?;
    let given = mask.resize(small.width(), small.height());
    drawing::difference(&mut silhouette, &given, &given);
    let mut marked = silhouette.clone();
    drawing::mark(&mut marked, &keypoints.scaled(small.focal() / camera.focal()));
    let tile = |image: Image, label: String| Tile { image, label };
    Ok([
        tile(drawing::cut(&silhouette, person)?, format!("{name}: frame {}", case.frame)),
        tile(drawing::cut(&marked, person)?, case.outfit.to_string()),
        tile(
            shown(&bare, Some(&errors(&bare)?))?,
            format!("SMPLify {:.0} mm", case.bare.distance_mm),
        ),
        tile(
            shown(&clothed, Some(&errors(&clothed)?))?,
            format!("CAPE {:.0} mm", case.clothed.distance_mm),
        ),
        tile(shown(&truth, None)?, "ground truth".into()),
    ])
}

/// Mean errors of both methods, each in ascending order.
pub(super) fn errors(cases: &[BenchmarkCase]) -> Result<Image> {
    let sorted = |name: &str, of: fn(&BenchmarkCase) -> f64| {
        let mut values: Vec<f64> = cases.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let points = values.into_iter().enumerate().map(|(at, error)| ((at + 1) as f64, error));
        Series { name: name.into(), points: points.collect() }
    };
    let plot = Plot {
        title: "Errors by image".into(),
        x_label: "images in ascending order of the method's error".into(),
        y_label: "mean distance at clothing vertices, mm".into(),
        log_y: false,
        series: vec![
            sorted("SMPLify", |case| case.bare.distance_mm),
            sorted("CAPE", |case| case.clothed.distance_mm),
        ],
    };
    Ok(plot.draw(900, 480)?)
}
