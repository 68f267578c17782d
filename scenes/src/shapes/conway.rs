//! Polyhedra as lists of faces, and Conway's operators on them (Conway, Burgiel and Goodman-Strauss 2008; Hart 1998).

use glam::DVec3;
use std::collections::HashMap;

/// Vertices, and faces as their indices counter-clockwise from outside; every edge belongs to two faces.
#[derive(Clone)]
pub(super) struct Polyhedron {
    pub points: Vec<DVec3>,
    pub faces: Vec<Vec<usize>>,
}

/// Largest number of vertices an operator may lead to.
const MOST: usize = 3000;

impl Polyhedron {
    /// Platonic solid of 4, 6, 8, 12 or 20 faces, corners on the unit sphere.
    pub fn platonic(faces: u32) -> Self {
        let new = |points: &[[f64; 3]], faces: &[&[usize]]| Self {
            points: points.iter().map(|&p| DVec3::from(p).normalize()).collect(),
            faces: faces.iter().map(|f| f.to_vec()).collect(),
        };
        match faces {
            4 => new(
                &[[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]],
                &[&[0, 1, 3], &[0, 3, 2], &[0, 2, 1], &[1, 2, 3]],
            ),
            6 => Self::platonic(8).dual(),
            12 => Self::platonic(20).dual(),
            20 => {
                let mut points: Vec<DVec3> = Vec::new();
                let faces = super::generate::icosahedron(0)
                    .iter()
                    .map(|f| {
                        let index = |p: &DVec3| {
                            points.iter().position(|q| q.distance(*p) < 1e-9).unwrap_or_else(|| {
                                points.push(*p);
                                points.len() - 1
                            })
                        };
                        f.iter().map(index).collect()
                    })
                    .collect();
                Self { points, faces }
            }
            _ => new(
                &[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]],
                &[&[0, 2, 4], &[2, 1, 4], &[1, 3, 4], &[3, 0, 4], &[2, 0, 5], &[1, 2, 5], &[3, 1, 5], &[0, 3, 5]],
            ),
        }
    }

    /// An upright prism or antiprism of regular polygons.
    pub fn prism(sides: usize, anti: bool) -> Self {
        let angle = |i: f64| std::f64::consts::TAU * i / sides as f64;
        let ring = |y: f64, turn: f64| {
            (0..sides).map(move |i| DVec3::new(angle(i as f64 + turn).sin(), y, angle(i as f64 + turn).cos()))
        };
        let points: Vec<DVec3> = ring(-0.6, 0.0).chain(ring(0.6, if anti { 0.5 } else { 0.0 })).collect();
        let mut faces = vec![(0..sides).rev().collect::<Vec<_>>(), (sides..2 * sides).collect()];
        for i in 0..sides {
            let j = (i + 1) % sides;
            if anti {
                faces.extend([vec![i, j, sides + i], vec![j, sides + j, sides + i]]);
            } else {
                faces.push(vec![i, j, sides + j, sides + i]);
            }
        }
        Self { points, faces }
    }

    pub fn edges(&self) -> usize {
        self.faces.iter().map(Vec::len).sum::<usize>() / 2
    }

    pub fn centre(&self, face: &[usize]) -> DVec3 {
        face.iter().map(|&i| self.points[i]).sum::<DVec3>() / face.len() as f64
    }

    fn normal(&self, face: &[usize]) -> DVec3 {
        let c = self.centre(face);
        let n = face.len();
        (0..n).map(|k| (self.points[face[k]] - c).cross(self.points[face[(k + 1) % n]] - c)).sum::<DVec3>().normalize_or(DVec3::Y)
    }

    /// The face left of each directed edge.
    fn left(&self) -> HashMap<(usize, usize), usize> {
        let mut left = HashMap::new();
        for (f, face) in self.faces.iter().enumerate() {
            for k in 0..face.len() {
                left.insert((face[k], face[(k + 1) % face.len()]), f);
            }
        }
        left
    }

    /// For each vertex its edges' other ends, counter-clockwise from outside.
    fn around(&self) -> Vec<Vec<usize>> {
        let mut next: Vec<HashMap<usize, usize>> = vec![HashMap::new(); self.points.len()];
        for face in &self.faces {
            let n = face.len();
            for k in 0..n {
                // In the face, the edge to the next corner is followed counter-clockwise by the edge to the one before.
                next[face[k]].insert(face[(k + 1) % n], face[(k + n - 1) % n]);
            }
        }
        next.iter()
            .map(|next| {
                let Some(&first) = next.keys().min() else { return Vec::new() };
                let mut ring = vec![first];
                while let Some(&n) = next.get(&ring[ring.len() - 1]).filter(|&&n| n != first && ring.len() < next.len()) {
                    ring.push(n);
                }
                ring
            })
            .collect()
    }

    /// Faces become vertices and vertices faces.
    pub fn dual(&self) -> Self {
        let left = self.left();
        let points = self.faces.iter().map(|f| self.centre(f)).collect();
        let faces = self
            .around()
            .iter()
            .enumerate()
            .map(|(v, ring)| ring.iter().filter_map(|&w| left.get(&(v, w)).copied()).collect())
            .collect();
        Self { points, faces }.rounded()
    }

    /// A pyramid of this height (a share of the face's radius) on every face.
    pub fn kis(&self, height: f64) -> Self {
        let mut out = Self { points: self.points.clone(), faces: Vec::new() };
        for face in &self.faces {
            let c = self.centre(face);
            let radius = face.iter().map(|&i| self.points[i].distance(c)).sum::<f64>() / face.len() as f64;
            out.points.push(c + self.normal(face) * radius * height);
            let tip = out.points.len() - 1;
            out.faces.extend((0..face.len()).map(|k| vec![face[k], face[(k + 1) % face.len()], tip]));
        }
        out
    }

    /// Corners cut to the middles of edges (`share` 0.5) or less deep (truncation).
    pub fn cut(&self, share: f64) -> Self {
        if share > 0.49 {
            return self.ambo();
        }
        let mut index = HashMap::new();
        let mut points = Vec::new();
        for face in &self.faces {
            for k in 0..face.len() {
                let (a, b) = (face[k], face[(k + 1) % face.len()]);
                index.insert((a, b), points.len());
                points.push(self.points[a].lerp(self.points[b], share));
            }
        }
        let mut faces: Vec<Vec<usize>> = self
            .faces
            .iter()
            .map(|f| {
                (0..f.len())
                    .flat_map(|k| [(f[k], f[(k + 1) % f.len()]), (f[(k + 1) % f.len()], f[k])])
                    .map(|e| index[&e])
                    .collect()
            })
            .collect();
        faces.extend(self.around().iter().enumerate().map(|(v, ring)| ring.iter().map(|&w| index[&(v, w)]).collect()));
        Self { points, faces }
    }

    fn ambo(&self) -> Self {
        let mut index = HashMap::new();
        let mut points = Vec::new();
        for face in &self.faces {
            for k in 0..face.len() {
                let (a, b) = (face[k], face[(k + 1) % face.len()]);
                index.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    points.push(0.5 * (self.points[a] + self.points[b]));
                    points.len() - 1
                });
            }
        }
        let edge = |a: usize, b: usize| index[&(a.min(b), a.max(b))];
        let mut faces: Vec<Vec<usize>> =
            self.faces.iter().map(|f| (0..f.len()).map(|k| edge(f[k], f[(k + 1) % f.len()])).collect()).collect();
        faces.extend(self.around().iter().enumerate().map(|(v, ring)| ring.iter().map(|&w| edge(v, w)).collect()));
        Self { points, faces }
    }

    /// Conway's gyro: each face becomes pentagons, all turned the same way. Its dual is the snub.
    pub fn gyro(&self) -> Self {
        let mut points = self.points.clone();
        let mut third = HashMap::new();
        for face in &self.faces {
            for k in 0..face.len() {
                let (a, b) = (face[k], face[(k + 1) % face.len()]);
                third.insert((a, b), points.len());
                points.push(self.points[a].lerp(self.points[b], 1.0 / 3.0));
            }
        }
        let mut faces = Vec::new();
        for face in &self.faces {
            let n = face.len();
            points.push(self.centre(face));
            let middle = points.len() - 1;
            for k in 0..n {
                let (z, a, b) = (face[(k + n - 1) % n], face[k], face[(k + 1) % n]);
                faces.push(vec![middle, third[&(z, a)], third[&(a, z)], a, third[&(a, b)]]);
            }
        }
        Self { points, faces }
    }

    /// One of the operators by number; the polyhedron itself when the result would be too large.
    pub fn operate(&self, operator: usize, amount: f64) -> Self {
        if self.edges() * 3 > MOST {
            return self.clone();
        }
        match operator {
            0 => self.kis(0.0).rounded(),
            1 => self.ambo().rounded(),
            2 => self.cut(0.2 + 0.2 * amount).rounded(),
            3 => self.dual(),
            4 => self.gyro().rounded(),
            5 => self.gyro().rounded().dual(),
            6 => self.ambo().ambo().rounded(),
            _ => self.ambo().dual(),
        }
    }

    /// Corners on the unit sphere.
    pub fn rounded(mut self) -> Self {
        self.points.iter_mut().for_each(|p| *p = p.normalize_or(DVec3::Y));
        self
    }

    /// Corners moved until faces are planar, or nearly so.
    pub fn planar(mut self) -> Self {
        for _ in 0..60 {
            let mut push = vec![(DVec3::ZERO, 0.0); self.points.len()];
            for face in self.faces.iter().filter(|f| f.len() > 3) {
                let (c, n) = (self.centre(face), self.normal(face));
                for &i in face {
                    push[i].0 += n * n.dot(c - self.points[i]);
                    push[i].1 += 1.0;
                }
            }
            for (p, (d, n)) in self.points.iter_mut().zip(push) {
                *p += d / f64::max(n, 1.0);
            }
        }
        self
    }

    /// One step of Catmull and Clark's subdivision (1978).
    pub fn smooth(&self) -> Self {
        let left = self.left();
        let n = self.points.len();
        let middles: Vec<DVec3> = self.faces.iter().map(|f| self.centre(f)).collect();
        let mut points = vec![DVec3::ZERO; n];
        points.extend(&middles);
        let mut edge = HashMap::new();
        for face in &self.faces {
            for k in 0..face.len() {
                let (a, b) = (face[k], face[(k + 1) % face.len()]);
                if let (true, Some(&f), Some(&g)) = (a < b, left.get(&(a, b)), left.get(&(b, a))) {
                    edge.insert((a, b), points.len());
                    points.push(0.25 * (self.points[a] + self.points[b] + middles[f] + middles[g]));
                }
            }
        }
        for (v, ring) in self.around().iter().enumerate() {
            let k = ring.len().max(1) as f64;
            let p = self.points[v];
            let faces = ring.iter().filter_map(|&w| left.get(&(v, w))).map(|&f| middles[f]).sum::<DVec3>() / k;
            let mids = ring.iter().map(|&w| 0.5 * (p + self.points[w])).sum::<DVec3>() / k;
            points[v] = (faces + 2.0 * mids + (k - 3.0) * p) / k;
        }
        let at = |a: usize, b: usize| edge.get(&(a.min(b), a.max(b))).copied().unwrap_or(a);
        let mut faces = Vec::new();
        for (f, face) in self.faces.iter().enumerate() {
            let m = face.len();
            for k in 0..m {
                faces.push(vec![face[k], at(face[k], face[(k + 1) % m]), n + f, at(face[(k + m - 1) % m], face[k])]);
            }
        }
        Self { points, faces }
    }

    /// An open frame in place of each face: a window of this share of the face, through a shell that goes in to `inner` of the
    /// radius.
    pub fn leonardo(&self, window: f64, inner: f64) -> Self {
        let n = self.points.len();
        let mut out = Self { points: self.points.clone(), faces: Vec::new() };
        out.points.extend(self.points.iter().map(|p| p * inner));
        for face in &self.faces {
            let c = self.centre(face);
            let m = face.len();
            let base = out.points.len();
            for scale in [1.0, inner] {
                out.points.extend(face.iter().map(|&i| scale * c.lerp(self.points[i], window)));
            }
            for k in 0..m {
                let j = (k + 1) % m;
                let (a, b) = (face[k], face[j]);
                out.faces.push(vec![a, b, base + j, base + k]);
                out.faces.push(vec![n + b, n + a, base + m + k, base + m + j]);
                out.faces.push(vec![base + k, base + j, base + m + j, base + m + k]);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vertices - edges + faces; every directed edge once, with its opposite.
    fn euler(p: &Polyhedron) -> i64 {
        let left = p.left();
        assert_eq!(left.len(), 2 * p.edges(), "an edge is walked twice in one direction");
        assert!(left.keys().all(|&(a, b)| left.contains_key(&(b, a))), "an open edge");
        p.points.len() as i64 - p.edges() as i64 + p.faces.len() as i64
    }

    #[test]
    fn platonic_solids_and_their_operators_are_spheres_with_known_counts() {
        for (faces, points, edges) in [(4, 4, 6), (6, 8, 12), (8, 6, 12), (12, 20, 30), (20, 12, 30)] {
            let p = Polyhedron::platonic(faces);
            assert_eq!((p.points.len(), p.edges(), p.faces.len()), (points, edges, faces as usize));
            for operator in 0..8 {
                let q = p.operate(operator, 0.5);
                assert_eq!(euler(&q), 2, "operator {operator} on {faces} faces");
                assert_eq!(euler(&q.operate(1, 0.5)), 2);
                // Every face looks outwards.
                assert!(q.faces.iter().all(|f| q.normal(f).dot(q.centre(f)) > 0.0), "operator {operator} on {faces} faces");
            }
            assert_eq!(euler(&p.smooth().smooth()), 2);
            // A frame with f windows has genus f - 1.
            assert_eq!(euler(&p.leonardo(0.6, 0.8)), 2 - 2 * (i64::from(faces) - 1));
            assert_eq!(p.cut(0.3).edges(), 3 * edges);
            assert_eq!(p.gyro().edges(), 5 * edges);
        }
        assert_eq!(euler(&Polyhedron::prism(7, false)), 2);
        assert_eq!(euler(&Polyhedron::prism(7, true)), 2);
    }
}
