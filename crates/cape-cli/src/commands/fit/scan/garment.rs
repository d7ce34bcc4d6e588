//! A template of a garment laid onto the scans of a sequence.

use std::path::{Path, PathBuf};

use cape_core::{MESH_EXTENSIONS, Mesh, geometry::SurfaceMesh, list_files};
use cape_fit::{
    GarmentConfig, GarmentTracker,
    scan::{Scan, ScanDistance, ScanUnit, distances_to},
};
use cape_infer::write_json;
use cape_render::{
    Bounds, Camera, Image, Object, Projection, Style, Tile, View, colormap, contact_sheet,
};
use glam::DVec3;
use serde::Serialize;

use super::{
    output::mesh,
    picture::{SCALE, scan_mesh},
};
use crate::{
    console::Console,
    error::{Error, Result},
    files,
    mesh_file::has_extension,
};

/// Frames in the picture.
const PICTURED: usize = 5;
const SIZE: [u32; 2] = [300, 380];

/// Result of the command.
#[derive(Debug, Serialize)]
struct GarmentReport {
    out: PathBuf,
    template: PathBuf,
    vertices: usize,
    frames: Vec<GarmentFrame>,
}

/// Registration of one scan.
#[derive(Debug, Serialize)]
struct GarmentFrame {
    scan: PathBuf,
    registration: PathBuf,
    /// Distances of the scan from the garment, millimetres.
    distance: ScanDistance,
}

/// Lays the mesh `template` onto a scan, or the scans of a directory in the order of their names, and
/// writes a mesh with its triangles for each.
pub(super) fn register(
    template: &Path,
    (scans, unit): (&Path, ScanUnit),
    config: GarmentConfig,
    out: &Path,
    console: Console,
) -> Result {
    let ScanUnit::Known(unit) = unit else {
        return Err(Error::message("--unit auto with --garment: expected m, cm or mm"));
    };
    let paths = scan_files(scans)?;
    let mut surface = SurfaceMesh::from_mesh("template", &Mesh::load(template)?)?;
    surface.vertices.iter_mut().for_each(|vertex| *vertex *= unit.metres());
    let faces = surface.faces.clone();
    let unit = ScanUnit::OfAnySize(unit);
    let mut tracker = GarmentTracker::new(&surface, config)?;
    files::create_dir(out)?;
    let mut frames = Vec::new();
    let mut shown = Vec::new();
    let every = paths.len().saturating_sub(1).div_ceil(PICTURED - 1).max(1);
    console.while_showing("garment", "scans", |progress| -> Result {
        for (index, path) in paths.iter().enumerate() {
            let scan = Scan::load(path, unit)?;
            let fit = tracker.register(&scan).map_err(|error| {
                Error::message(format!(
                    "{}: {error}: give a template that lies near the garment of the first scan",
                    path.display()
                ))
            })?;
            let stem = path.file_stem().unwrap_or_default();
            let registration = out.join(stem).with_extension("ply");
            mesh(&fit.vertices, &faces).save(&registration)?;
            if index % every == 0 || index + 1 == paths.len() {
                let name = stem.to_string_lossy().into_owned();
                shown.push((name, scan, fit.vertices));
            }
            frames.push(GarmentFrame { scan: path.clone(), registration, distance: fit.distance });
            progress(index + 1, paths.len());
        }
        Ok(())
    })?;
    draw(&shown, &faces)?.save(out.join("garment.png"))?;
    let vertices = surface.vertices.len();
    let report = GarmentReport {
        out: out.to_path_buf(),
        template: template.to_path_buf(),
        vertices,
        frames,
    };
    write_json(&out.join("garment.json"), &report)?;
    console.result(&report, || text(&report))
}

/// Scans of a directory in natural order, or the file itself.
fn scan_files(scans: &Path) -> Result<Vec<PathBuf>> {
    if !scans.is_dir() {
        return Ok(vec![scans.to_path_buf()]);
    }
    let is_scan = |path: &Path| {
        let extensions = MESH_EXTENSIONS.iter().chain(&["npz"]);
        path.is_file() && extensions.into_iter().any(|extension| has_extension(path, extension))
    };
    let found = list_files(scans, is_scan)?;
    if found.is_empty() {
        return Err(Error::message(format!(
            "{}: no scans, expected .{} or .npz files",
            scans.display(),
            MESH_EXTENSIONS.join(", .")
        )));
    }
    let stem = |path: &PathBuf| path.file_stem().unwrap_or_default().to_os_string();
    if let Some(pair) = found.windows(2).find(|pair| stem(&pair[0]) == stem(&pair[1])) {
        return Err(Error::message(format!(
            "{} and {}: two scans of one name, expected one for each frame",
            pair[0].display(),
            pair[1].display()
        )));
    }
    Ok(found)
}

/// Scans above, and the garment below, coloured by its distance from them.
fn draw(shown: &[(String, Scan, Vec<DVec3>)], faces: &[[u32; 3]]) -> Result<Image> {
    let [width, height] = SIZE;
    let style = Style { width, height, ..Style::default() };
    let aspect = width as f32 / height as f32;
    let mut rows: [Vec<Tile>; 2] = [Vec::new(), Vec::new()];
    for (name, scan, vertices) in shown {
        let worn = mesh(vertices, faces);
        let bounds = Bounds::from_meshes([&worn])
            .ok_or_else(|| Error::message("internal error: no mesh to draw"))?;
        let camera = Camera::framing(&bounds, View::ThreeQuarter, Projection::default(), aspect);
        let distances = distances_to(scan, vertices).into_iter();
        let colours: Vec<[f32; 3]> = distances.map(|off| colormap((off / SCALE) as f32)).collect();
        let scanned: Mesh = scan_mesh(scan);
        for (row, object, label) in [
            (0, Object::new(&scanned), name.clone()),
            (1, Object::new(&worn).with_colours(&colours), format!("0 to {:.0} mm", 1e3 * SCALE)),
        ] {
            rows[row].push(Tile { image: cape_render::render(&[object], &camera, &style)?, label });
        }
    }
    let tiles = rows.concat();
    Ok(contact_sheet(&tiles, shown.len(), None)?)
}

fn text(report: &GarmentReport) -> String {
    let medians = report.frames.iter().map(|frame| frame.distance.median);
    let worst = report.frames.iter().max_by(|a, b| a.distance.median.total_cmp(&b.distance.median));
    let mut lines = vec![format!(
        "{} scans: distance of the scan from the garment, median {:.1} mm",
        report.frames.len(),
        medians.sum::<f64>() / report.frames.len().max(1) as f64
    )];
    if let Some(worst) = worst.filter(|_| report.frames.len() > 1) {
        lines.push(format!(
            "largest median {:.1} mm, of {}",
            worst.distance.median,
            worst.scan.display()
        ));
    }
    lines.push(report.out.join("garment.png").display().to_string());
    lines.push(format!(
        "next: cape layer import {} MOTION --set SET --name NAME",
        report.out.display()
    ));
    lines.join("\n")
}
