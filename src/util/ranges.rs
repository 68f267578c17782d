//! Numbers and sizes on the command line, and their ranges.

use clap::builder::RangedI64ValueParser;
use std::ops::RangeInclusive;

/// Accepts the numbers in `range`.
pub fn within(range: RangeInclusive<u32>) -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(i64::from(*range.start())..=i64::from(*range.end()))
}

/// Width and height of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution(pub [u32; 2]);

/// Accepts `640x480`, or `512` for a square, with both sides in `range`.
pub fn resolution(range: RangeInclusive<u32>) -> impl Fn(&str) -> Result<Resolution, String> + Clone + Send + Sync + 'static {
    move |text| {
        let (width, height) = text.split_once(['x', 'X']).unwrap_or((text, text));
        let side = |side: &str| match side.parse::<u32>() {
            Ok(pixels) if range.contains(&pixels) => Ok(pixels),
            Ok(pixels) => Err(format!("{pixels} is not in {}..={}", range.start(), range.end())),
            Err(_) => Err("give WIDTHxHEIGHT as in 640x480, or one number for a square".to_owned()),
        };
        Ok(Resolution([side(width)?, side(height)?]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_one_number_or_two() {
        let parse = resolution(16..=4096);
        assert_eq!(parse("512"), Ok(Resolution([512, 512])));
        assert_eq!(parse("640x480"), Ok(Resolution([640, 480])));
        assert_eq!(parse("640X480"), Ok(Resolution([640, 480])));
        for bad in ["", "x", "640x", "x480", "640x480x3", "640 480", "-3", "1.5", "wide"] {
            assert!(parse(bad).is_err_and(|said| said.contains("WIDTHxHEIGHT")), "{bad}");
        }
        for bad in ["15", "16x4097", "4294967295x16"] {
            assert!(parse(bad).is_err_and(|said| said.contains("is not in 16..=4096")), "{bad}");
        }
    }
}
