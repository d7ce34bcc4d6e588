//! Simplifies a mesh level by level, as the generator's pooling does.
//!
//! ```sh
//! cargo run --release --example mesh_pyramid [MESH.obj]
//! ```

use cape::{
    core::{Mesh, smpl::Gender},
    graph::{MeshPyramid, Surface, Weighting},
    synth::embedded_body,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mesh = match std::env::args().nth(1) {
        Some(path) => Mesh::load(path)?,
        None => embedded_body(Gender::Neutral)?.mesh(),
    };
    let start = std::time::Instant::now();
    let factors = [2.0, 2.0, 2.0];
    let pyramid = MeshPyramid::build(Surface::from(&mesh), &factors, Weighting::Barycentric)?;
    println!("built in {:.3} s", start.elapsed().as_secs_f64());
    for (index, level) in pyramid.levels().iter().enumerate() {
        let edges = level.edge_counts();
        println!(
            "level {index}: {} vertices, {} faces, {} edges ({} non-manifold)",
            level.vertex_count(),
            level.surface().faces.len(),
            edges.edges,
            edges.non_manifold
        );
    }
    // Interpolates level 1 back to level 0: every row's weights sum to 1.
    let up = pyramid.transitions()[0].up();
    println!("up-sampling: {:?}, {} weights", up.shape(), up.nnz());
    Ok(())
}
