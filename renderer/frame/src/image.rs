//! A row-major picture of any pixel type, origin at the top left.

/// A picture of `width * height` pixels, row-major, first row at the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `pixels[y * width + x]`.
    pub pixels: Vec<T>,
}

/// Three floats per pixel: linear radiance, albedo, a normal, or (roughness, metallic, specular).
pub type Rgb = Image<[f32; 3]>;

impl<T: Clone> Image<T> {
    /// A picture filled with one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, pixels: vec![value; width * height] }
    }

    /// The `width x height` window whose top-left corner is `(x, y)`.
    ///
    /// # Panics
    /// When the window leaves the picture.
    pub fn crop(&self, x: usize, y: usize, width: usize, height: usize) -> Self {
        assert!(x + width <= self.width && y + height <= self.height, "crop leaves the picture");
        let pixels = (y..y + height)
            .flat_map(|row| self.pixels[row * self.width + x..row * self.width + x + width].iter().cloned())
            .collect();
        Self { width, height, pixels }
    }
}

impl<T> Image<T> {
    /// Calls `f(x, y)` for every pixel, row by row.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let pixels = (0..width * height).map(|i| f(i % width, i / width)).collect();
        Self { width, height, pixels }
    }

    /// The pixel at column `x`, row `y`.
    pub fn at(&self, x: usize, y: usize) -> &T {
        &self.pixels[y * self.width + x]
    }

    /// The same picture with `f` applied to each pixel.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Image<U> {
        Image { width: self.width, height: self.height, pixels: self.pixels.iter().map(f).collect() }
    }
}
