//! Makes a body and draws it in ten shapes and six poses, from the front and the side:
//! `cargo run --release -p cape-body --example body_sheet -- WHEEL GENDER DIRECTORY`.

use std::{error::Error, path::PathBuf};

use cape_body::{Assets, Gender, make_body};
use cape_core::{Mesh, SmplModel};
use cape_render::{Bounds, Camera, Object, Projection, Style, Tile, View, contact_sheet, render};

fn tile(mesh: &Mesh, bounds: &Bounds, view: View, label: String) -> Result<Tile, Box<dyn Error>> {
    let style = Style { width: 340, height: 360, ..Style::default() };
    let camera = Camera::framing(bounds, view, Projection::Orthographic, 340.0 / 360.0);
    Ok(Tile { image: render(&[Object::new(mesh)], &camera, &style)?, label })
}

fn posed(body: &SmplModel, betas: &[f64], pose: &[f64]) -> Result<Mesh, Box<dyn Error>> {
    let posed = body.pose(betas, pose, [0.0; 3], None)?;
    let vertices =
        posed.vertices.rows().into_iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]);
    Ok(Mesh { vertices: vertices.collect(), faces: body.faces.clone() })
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [wheel, gender, directory] = arguments.as_slice() else {
        return Err("expected WHEEL GENDER DIRECTORY".into());
    };
    let directory = PathBuf::from(directory);
    let gender: Gender = gender.parse()?;
    let half = make_body(&mut Assets::open(wheel)?, gender)?;
    let bytes = half.encode()?;
    std::fs::write(directory.join(format!("{gender}.body")), &bytes)?;
    println!("{gender}: {} bytes, {} midline vertices", bytes.len(), half.midline);
    let body = half.model();
    body.validate()?;
    body.save_textured(directory.join(format!("{gender}.npz")), &half.texture())?;
    let zero = [0.0; 72];

    let mut tiles = Vec::new();
    let rest = posed(&body, &[], &zero)?;
    let all = Bounds::from_points(&[[-1.0_f32, -1.35, -0.3], [1.0, 0.85, 0.3]]).ok_or("empty")?;
    for direction in 0..5 {
        for sign in [-2.0, 2.0] {
            let mut betas = vec![0.0; 10];
            betas[direction] = sign;
            let mesh = posed(&body, &betas, &zero)?;
            let bounds = mesh.bounding_box().ok_or("empty")?;
            let label = format!("beta {direction} {sign:+} {:.2} m", bounds[1][1] - bounds[0][1]);
            tiles.push(tile(&mesh, &all, View::Front, label.clone())?);
            tiles.push(tile(&mesh, &all, View::Side, label)?);
        }
    }
    contact_sheet(&tiles, 5 * 2, None)?.save(directory.join(format!("{gender}-shapes.png")))?;

    let mut tiles = vec![
        tile(&rest, &all, View::Front, "rest".into())?,
        tile(&rest, &all, View::Side, "rest".into())?,
    ];
    let bends = [
        ("elbows", vec![(18, [0.0, -1.9, 0.0]), (19, [0.0, 1.9, 0.0])]),
        ("knees", vec![(1, [-1.4, 0.0, 0.0]), (4, [1.8, 0.0, 0.0]), (5, [1.4, 0.0, 0.0])]),
        ("arms down", vec![(16, [0.0, 0.0, -1.2]), (17, [0.0, 0.0, 1.2])]),
        (
            "arms up",
            vec![
                (13, [0.0, 0.0, 0.3]),
                (14, [0.0, 0.0, -0.3]),
                (16, [0.0, 0.0, 0.9]),
                (17, [0.0, 0.0, -0.9]),
            ],
        ),
        (
            "stoop",
            vec![
                (3, [0.5, 0.0, 0.0]),
                (6, [0.4, 0.0, 0.0]),
                (9, [0.3, 0.3, 0.0]),
                (12, [0.3, 0.5, 0.0]),
            ],
        ),
    ];
    for (name, bend) in &bends {
        let mut pose = zero;
        for &(joint, axis) in bend {
            pose[3 * joint..3 * joint + 3].copy_from_slice(&axis);
        }
        let mesh = posed(&body, &[], &pose)?;
        tiles.push(tile(&mesh, &all, View::Front, (*name).into())?);
        tiles.push(tile(&mesh, &all, View::Side, (*name).into())?);
    }
    contact_sheet(&tiles, 6, None)?.save(directory.join(format!("{gender}-poses.png")))?;

    let mut tiles = Vec::new();
    for (name, low, high) in [
        ("head", [-0.14_f32, 0.25, -0.2], [0.14, 0.65, 0.25]),
        ("hand", [0.60, 0.0, -0.15], [0.95, 0.45, 0.15]),
        ("foot", [0.0, -1.3, -0.2], [0.3, -1.0, 0.25]),
    ] {
        let bounds = Bounds::from_points(&[low, high]).ok_or("empty")?;
        for view in [View::Front, View::Side, View::ThreeQuarter] {
            tiles.push(tile(&rest, &bounds, view, name.into())?);
        }
    }
    contact_sheet(&tiles, 9, None)?.save(directory.join(format!("{gender}-details.png")))?;
    Ok(())
}
