//! Draws the embedded bodies into a directory: all three in five poses (`bodies.png`), the female in the ten
//! shape directions (`body-shapes.png`), and each, textured, in all directions and in six poses, from the
//! front and the side:
//! `cargo run --release -p cape-body --example body_sheet -- DIRECTORY`.

use std::{error::Error, path::PathBuf};

use cape_body::Gender;
use cape_core::{Mesh, SmplModel, obj::Uv};
use cape_render::{
    Bounds, Camera, Image, Object, Projection, Style, Texture, Tile, View, contact_sheet, render,
};
use cape_synth::HalfBody;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Rotations of some joints, radians.
type Bends = &'static [(usize, [f64; 3])];

const BENDS: [(&str, Bends); 6] = [
    ("rest", &[]),
    ("arms down", &[(16, [0.0, 0.0, -1.2]), (17, [0.0, 0.0, 1.2])]),
    (
        "arms up",
        &[
            (13, [0.0, 0.0, 0.3]),
            (14, [0.0, 0.0, -0.3]),
            (16, [0.0, 0.0, 0.9]),
            (17, [0.0, 0.0, -0.9]),
        ],
    ),
    ("elbows", &[(18, [0.0, -1.9, 0.0]), (19, [0.0, 1.9, 0.0])]),
    (
        "hip and knees",
        &[
            (1, [-1.57, 0.0, 0.0]),
            (4, [2.09, 0.0, 0.0]),
            (5, [1.4, 0.0, 0.0]),
            (16, [0.0, 0.0, -1.2]),
            (17, [0.0, 0.0, 1.2]),
        ],
    ),
    (
        "stoop",
        &[
            (3, [0.5, 0.0, 0.0]),
            (6, [0.4, 0.0, 0.0]),
            (9, [0.3, 0.3, 0.0]),
            (12, [0.3, 0.5, 0.0]),
            (16, [0.0, 0.0, -1.2]),
            (17, [0.0, 0.0, 1.2]),
        ],
    ),
];
/// Width and height of a tile, pixels.
const TILE: (u32, u32) = (260, 300);

struct Sitter {
    body: SmplModel,
    uv: Uv,
    skin: Image,
    textured: bool,
}

impl Sitter {
    fn new(gender: Gender) -> Outcome<Self> {
        let half = HalfBody::embedded(gender)?;
        Ok(Self { body: half.model(), uv: half.texture(), skin: chequered()?, textured: false })
    }

    fn mesh(&self, betas: &[f64], bends: Bends) -> Outcome<Mesh> {
        let mut pose = [0.0; 72];
        for &(joint, axis) in bends {
            pose[3 * joint..3 * joint + 3].copy_from_slice(&axis);
        }
        let posed = self.body.pose(betas, &pose, [0.0; 3], None)?;
        let vertices =
            posed.vertices.rows().into_iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]);
        Ok(Mesh { vertices: vertices.collect(), faces: self.body.faces.clone() })
    }

    fn tile(&self, mesh: &Mesh, bounds: &Bounds, view: View, label: String) -> Outcome<Tile> {
        let (width, height) = TILE;
        let style = Style { width, height, ..Style::default() };
        let aspect = width as f32 / height as f32;
        let camera = Camera::framing(bounds, view, Projection::Orthographic, aspect);
        let texture = Texture { uv: &self.uv, image: &self.skin };
        let plain = Object::new(mesh);
        let object = if self.textured { plain.with_texture(texture) } else { plain };
        Ok(Tile { image: render(&[object], &camera, &style)?, label })
    }
}

/// Chequered skin, which shows how the texture coordinates stretch.
fn chequered() -> Outcome<Image> {
    const SIZE: u32 = 1024;
    const SQUARE: u32 = 32;
    let mut image = Image::new(SIZE, SIZE, [222, 184, 160, 255])?;
    for (at, pixel) in (0..).zip(image.pixels_mut()) {
        if (at % SIZE / SQUARE + at / SIZE / SQUARE) % 2 == 1 {
            *pixel = [206, 164, 140, 255];
        }
    }
    Ok(image)
}

fn main() -> Outcome<()> {
    let directory = PathBuf::from(std::env::args().nth(1).ok_or("expected DIRECTORY")?);
    let bounds = |low, high| Bounds::from_points(&[low, high]).ok_or("empty");
    let standing = bounds([-0.85_f32, -1.33, -0.3], [0.85, 0.9, 0.3])?;
    let narrow = bounds([-0.5_f32, -1.33, -0.3], [0.5, 0.6, 0.3])?;
    let mut overview = Vec::new();
    for gender in [Gender::Male, Gender::Female, Gender::Neutral] {
        let mut sitter = Sitter::new(gender)?;
        for (pose, view) in
            [(0, View::Front), (1, View::Side), (1, View::Front), (4, View::Side), (2, View::Front)]
        {
            let (name, bends) = BENDS[pose];
            let label = format!("{gender}, {name}");
            overview.push(sitter.tile(&sitter.mesh(&[], bends)?, &standing, view, label)?);
        }
        let shaped = |direction: usize, sign: f64| {
            let mut betas = [0.0; 10];
            betas[direction] = sign;
            (betas, format!("shape {} {sign:+}", direction + 1))
        };
        if gender == Gender::Female {
            let mut tiles = Vec::new();
            for (first, sign) in [(0, -2.0), (0, 2.0), (5, -2.0), (5, 2.0)] {
                for direction in first..first + 5 {
                    let (betas, label) = shaped(direction, sign);
                    let mesh = sitter.mesh(&betas, BENDS[1].1)?;
                    tiles.push(sitter.tile(&mesh, &narrow, View::Front, label)?);
                }
            }
            contact_sheet(&tiles, 5, None)?.save(directory.join("body-shapes.png"))?;
        }
        sitter.textured = true;
        let mut shapes = Vec::new();
        for direction in 0..10 {
            for sign in [-2.0, 2.0] {
                let (betas, label) = shaped(direction, sign);
                let mesh = sitter.mesh(&betas, BENDS[1].1)?;
                for view in [View::Front, View::Side] {
                    shapes.push(sitter.tile(&mesh, &standing, view, label.clone())?);
                }
            }
        }
        contact_sheet(&shapes, 8, None)?.save(directory.join(format!("{gender}-shapes.png")))?;
        let mut poses = Vec::new();
        for (name, bends) in BENDS {
            let mesh = sitter.mesh(&[], bends)?;
            for view in [View::Front, View::Side] {
                poses.push(sitter.tile(&mesh, &standing, view, name.into())?);
            }
        }
        contact_sheet(&poses, 6, None)?.save(directory.join(format!("{gender}-poses.png")))?;
        let rest = sitter.mesh(&[], &[])?;
        let mut details = Vec::new();
        for (name, low, high) in [
            ("head", [-0.12_f32, 0.25, -0.1], [0.12, 0.55, 0.2]),
            ("hand", [0.60, 0.1, -0.15], [0.95, 0.3, 0.15]),
            ("foot", [0.05, -1.25, -0.1], [0.25, -1.05, 0.2]),
        ] {
            for view in [View::Front, View::ThreeQuarter] {
                details.push(sitter.tile(&rest, &bounds(low, high)?, view, name.into())?);
            }
        }
        contact_sheet(&details, 6, None)?.save(directory.join(format!("{gender}-details.png")))?;
    }
    contact_sheet(&overview, 5, None)?.save(directory.join("bodies.png"))?;
    Ok(())
}
