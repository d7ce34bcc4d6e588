//! Dresses a body: clothing displacements of a garment, added to SMPL's template and posed.
//!
//! ```sh
//! cargo run --release --example dress_a_body
//! ```

use cape::{
    burn::tensor::{Device, Tensor, TensorData},
    core::{ClothedSmpl, ClothingMask, Outfit, Pose, Smpl, SmplInput, smpl::Gender},
    synth::{Motion, MotionStyle, Wardrobe, embedded_body},
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Any body in SMPL's layout works: `SmplModel::load("SMPL_NEUTRAL.npz")`.
    let model = embedded_body(Gender::Neutral)?;
    let pose = Motion::WalkMarch.pose(&MotionStyle::default(), 0.4);

    // A garment's displacement in canonical space, metres, [vertices, 3].
    let wardrobe = Wardrobe::new(&model, 1)?;
    let fitting = wardrobe.fit(wardrobe.outfit_style(0, Outfit::LONG_LONG, 0)?);
    let displacement = wardrobe.displacement(&fitting, &pose, 0.0, None)?;

    // CAPE's eq. 3-4: joints from the body, displacements at clothing vertices.
    let device = Device::default();
    let mask = ClothingMask::from_indices(model.vertices(), &wardrobe.clothing_vertices())?;
    let clothed = ClothedSmpl::new(Smpl::new(&model, &device)?).with_mask(&mask)?;
    let tensor = |values: &mut dyn Iterator<Item = f64>, width: usize| {
        let values: Vec<f32> = values.map(|x| x as f32).collect();
        Tensor::<2>::from_data(TensorData::new(values, [1, width]), &device)
    };
    let width = 3 * model.vertices();
    let output = clothed.forward(SmplInput {
        betas: tensor(&mut [1.0, -0.5].into_iter(), 2),
        pose: Pose::AxisAngle(tensor(&mut pose.into_iter(), 72)),
        transl: Tensor::zeros([1, 3], &device),
        displacement: Some(tensor(&mut displacement.into_iter(), width).reshape([
            1,
            model.vertices(),
            3,
        ])),
    })?;

    let vertices: Vec<f32> = output.vertices.into_data().try_into_vec().map_err(|_| "not f32")?;
    let mesh =
        cape::core::Mesh { vertices: vertices.as_chunks().0.to_vec(), faces: model.faces.clone() };
    let path = std::env::temp_dir().join("dressed.obj");
    mesh.save(&path)?;
    println!("{}: {} vertices", path.display(), mesh.vertices.len());
    Ok(())
}
