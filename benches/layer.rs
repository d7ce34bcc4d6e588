//! Tying a dress of about 20,000 vertices to a body of 6890, by either metric, and taking out and
//! putting back the pose of a frame.

use std::time::Instant;

use cape::{
    cloth::{Garment, GarmentKind},
    core::{geometry::SurfaceMesh, smpl::StandardPose},
    layer::{AssociateOptions, BodyFrame, geometry::GeodesicMetric},
    synth::synthetic_body,
};
use ndarray::Array2;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let model = synthetic_body();
    let shape = model.rest_shape(&[])?;
    let garment = Garment { resolution: 0.0088, ..Garment::new(GarmentKind::Dress) };
    let start = Instant::now();
    let dress = garment.sew(&model, &shape)?.surface;
    println!("{} vertices sewn in {:.1} s", dress.vertices.len(), start.elapsed().as_secs_f64());
    let body = SurfaceMesh::from_rows("body", shape.view(), &model.faces)?;
    for metric in [GeodesicMetric::Graph, GeodesicMetric::Unfolded] {
        let options = AssociateOptions { metric, ..AssociateOptions::default() };
        let start = Instant::now();
        let association = options.associate(&body, &dress)?;
        println!(
            "{metric:?}: {} pairs, {} vertices completed, {:.2} s",
            association.pairs,
            association.completion.total(),
            start.elapsed().as_secs_f64()
        );
    }
    let association = AssociateOptions::default().associate(&body, &dress)?;
    let rest = vec![0.0; 72];
    let clothing = Array2::from_shape_fn((dress.vertices.len(), 3), |(v, k)| dress.vertices[v][k]);
    let start = Instant::now();
    let frame = BodyFrame::new(&model, &shape, &rest, [0.0; 3], &StandardPose::A)?;
    let offsets = association.offsets(&frame, clothing.view())?;
    let back = association.dress(&frame, offsets.view())?;
    let off = (back - clothing).iter().fold(0.0f64, |most, d| most.max(d.abs()));
    println!("a frame there and back, off by {off:.1e} m: {:.0?}", start.elapsed());
    Ok(())
}
