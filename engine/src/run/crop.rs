//! Magnification of turned images of a scene in time, so that the picture's edges are outside of them.

use crate::Image;

/// Columns of the images in which edges are searched.
pub const COLUMNS: usize = 128;
/// Most images of a motion that are examined, evenly spaced.
pub const IMAGES: usize = 25;
/// The least part of the sides that is shown.
const LEAST: f64 = 0.5;
/// Least alpha of a covered pixel.
const SEEN: f32 = 0.5;

/// The largest part of an image's sides, around its middle, without pixels outside of the picture: those that are
/// uncovered and connected to the image's edge. Holes inside are ignored. At least one half.
pub fn shown_part(image: &Image) -> f64 {
    let (width, height) = (image.width, image.height);
    let Some(alpha) = image.alpha.as_deref() else { return 1.0 };
    let mut outside = vec![false; width * height];
    let mut next: Vec<usize> = (0..width * height)
        .filter(|i| i % width == 0 || i % width == width - 1 || *i < width || *i >= width * (height - 1))
        .collect();
    let mut part: f64 = 1.0;
    while let Some(i) = next.pop() {
        if outside[i] || alpha[i] >= SEEN {
            continue;
        }
        outside[i] = true;
        let (x, y) = (i % width, i / width);
        // The side of the pixel nearest to the middle.
        let near = |place: usize, side: usize| ((2 * place + 1).abs_diff(side) as f64 - 1.0) / side as f64;
        part = part.min(near(x, width).max(near(y, height)));
        let around = [(x > 0, i.wrapping_sub(1)), (x + 1 < width, i + 1)];
        let around = around.into_iter().chain([(y > 0, i.wrapping_sub(width)), (y + 1 < height, i + width)]);
        next.extend(around.filter(|(inside, _)| *inside).map(|(_, i)| i));
    }
    part.max(LEAST)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, covered: impl Fn(usize, usize) -> bool) -> Image {
        let alpha = (0..width * height).map(|i| f32::from(u8::from(covered(i % width, i / width)))).collect();
        Image { width, height, alpha: Some(alpha), ..Image::default() }
    }

    #[test]
    fn bars_are_left_out_and_holes_are_not() {
        assert_eq!(shown_part(&image(20, 10, |_, _| true)), 1.0);
        // Two columns on the left.
        assert_eq!(shown_part(&image(20, 10, |x, _| x >= 2)), 0.8);
        // A row below.
        assert_eq!(shown_part(&image(20, 10, |_, y| y < 9)), 0.8);
        // A corner: the side that needs less magnification counts.
        assert_eq!(shown_part(&image(20, 20, |x, y| x >= 5 || y >= 1)), 0.9);
        // A hole, and one that a bar reaches.
        assert_eq!(shown_part(&image(20, 10, |x, y| x != 8 || y != 5)), 1.0);
        assert_eq!(shown_part(&image(20, 10, |x, y| y != 5 || x > 2)), 0.7);
        // Nothing at all.
        assert_eq!(shown_part(&image(20, 10, |_, _| false)), LEAST);
        assert_eq!(shown_part(&Image { width: 4, height: 4, ..Image::default() }), 1.0);
    }
}
