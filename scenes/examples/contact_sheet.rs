//! Writes OBJ files of random shapes, 8 x 8 on a floor, to look at:
//! `cargo run --release -p renderflow-scenes --example contact_sheet -- OUT.obj SEED FAMILY...` (all families when none is named).

use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::{FAMILIES, Shape, mesh};
use std::fmt::Write as _;

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or_else(|| "sheet.obj".into());
    let seed: u64 = arguments.next().and_then(|s| s.parse().ok()).unwrap_or(0);
    let named: Vec<String> = arguments.collect();
    let families: Vec<&str> = if named.is_empty() { FAMILIES[2..].to_vec() } else { named.iter().map(String::as_str).collect() };
    let (mut text, mut base) = (String::new(), 1);
    for cell in 0..64usize {
        // Whole rows of one family where there are few.
        let family = if families.len() <= 8 { families[cell / 8 % families.len()] } else { families[cell % families.len()] };
        let shape = Shape::random_of(family, &mut Seed::root(seed).child(family, cell as u64).rng());
        let m = mesh(&shape);
        let low = m.positions.iter().map(|p| p.y).fold(f32::INFINITY, f32::min);
        let widest = m.positions.iter().map(|p| p.x.hypot(p.z)).fold(0.5, f32::max);
        let scale = 0.68 / widest;
        let (x, z) = ((cell % 8) as f32 * 1.6 - 5.6, (cell / 8) as f32 * 1.6 - 5.6);
        let _ = writeln!(text, "o {family}_{cell}");
        for p in &m.positions {
            let _ = writeln!(text, "v {} {} {}", p.x * scale + x, (p.y - low) * scale, p.z * scale + z);
        }
        for uv in &m.uvs {
            let _ = writeln!(text, "vt {} {}", uv.x, 1.0 - uv.y);
        }
        for n in &m.normals {
            let _ = writeln!(text, "vn {} {} {}", n.x, n.y, n.z);
        }
        for t in &m.triangles {
            let [a, b, c] = t.map(|i| i + base);
            let _ = writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}");
        }
        base += m.positions.len() as u32;
    }
    std::fs::write(path, text)
}
