//! Draws a body with a checked texture by its side, smooth and flat, and its silhouette.
//!
//! ```sh
//! cargo run --release --example picture
//! ```

use cape::{
    core::{obj::Uv, smpl::Gender},
    render::{
        Bounds, Camera, Image, Object, Projection, Style, Texture, Tile, View, contact_sheet,
        render, silhouette,
    },
    synth::embedded_body,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mesh = embedded_body(Gender::Neutral)?.mesh();
    let bounds = Bounds::from_meshes([&mesh]).ok_or("no vertices")?;
    let style = Style { width: 320, height: 512, ..Style::default() };
    let aspect = 320.0 / 512.0;
    let camera = Camera::framing(&bounds, View::ThreeQuarter, Projection::Orthographic, aspect);

    // Heights and widths as texture coordinates; SMPL's own come with `obj::read`.
    let coordinates = mesh.vertices.iter().map(|v| [4.0 * v[0], 4.0 * v[1]]).collect();
    let uv = Uv { coordinates, faces: mesh.faces.clone() };
    let mut image = Image::new(64, 64, [226, 205, 160, 255])?;
    for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
        if (i / 32 + i / 64 / 32) % 2 == 0 {
            *pixel = [70, 105, 140, 255];
        }
    }
    let texture = Texture { uv: &uv, image: &image };
    let object = Object::new(&mesh);
    let pictures = [
        ("smooth", render(&[object], &camera, &style)?),
        ("flat", render(&[object.with_flat_shading()], &camera, &style)?),
        ("textured", render(&[object.with_texture(texture)], &camera, &style)?),
        ("silhouette", silhouette(&mesh, &camera, style.width, style.height)?),
    ];
    let tiles = pictures.map(|(name, image)| Tile { image, label: name.into() });
    contact_sheet(&tiles, 4, None)?.save("picture.png")?;
    Ok(())
}
