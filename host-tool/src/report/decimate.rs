//! Long series on little paper: fewer points, the same picture.

/// x and y.
type Point = (f64, f64);

/// At most about `most` points that keep the ends and, within equal stretches of the series, the smallest and largest x and y, in
/// order: no peak and no corner of a loop is lost. A short series comes back as it is.
#[must_use]
pub fn decimate(points: &[Point], most: usize) -> Vec<Point> {
    let most = most.max(8);
    if points.len() <= most {
        return points.to_vec();
    }
    // Four extremes a stretch, the ends included in the first and last.
    let stretch = points.len().div_ceil(most / 4);
    let mut kept = Vec::with_capacity(most + 8);
    for (number, part) in points.chunks(stretch).enumerate() {
        let mut indices = vec![];
        let mut keep = |better: &dyn Fn(&Point, &Point) -> bool| {
            let mut best = 0;
            for (index, point) in part.iter().enumerate() {
                if better(point, &part[best]) {
                    best = index;
                }
            }
            indices.push(best);
        };
        keep(&|point, best| point.0 < best.0);
        keep(&|point, best| point.0 > best.0);
        keep(&|point, best| point.1 < best.1);
        keep(&|point, best| point.1 > best.1);
        // A hole must stay a hole.
        indices.extend(part.iter().position(|point| !(point.0.is_finite() && point.1.is_finite())));
        if number == 0 {
            indices.push(0);
        }
        if (number + 1) * stretch >= points.len() {
            indices.push(part.len() - 1);
        }
        indices.sort_unstable();
        indices.dedup();
        kept.extend(indices.into_iter().map(|index| part[index]));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_spike_among_many_samples_survives_with_both_ends() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|index| (f64::from(index), (f64::from(index) * 0.001).sin())).collect();
        points[54_321].1 = 40.0;
        points[77_777].1 = -40.0;
        let kept = decimate(&points, 1000);
        assert!(kept.len() <= 1010, "{}", kept.len());
        assert!(kept.contains(&points[54_321]) && kept.contains(&points[77_777]));
        assert_eq!((kept[0], kept[kept.len() - 1]), (points[0], points[99_999]));
        assert!(kept.windows(2).all(|pair| pair[0].0 < pair[1].0), "the order is kept");
    }

    #[test]
    fn short_empty_and_holed_series_survive() {
        assert!(decimate(&[], 100).is_empty());
        let short = [(0.0, 1.0), (1.0, 2.0)];
        assert_eq!(decimate(&short, 100), short);
        let mut holed: Vec<(f64, f64)> = (0..10_000).map(|index| (f64::from(index), 1.0)).collect();
        holed[5000].1 = f64::NAN;
        assert!(decimate(&holed, 100).iter().any(|point| point.1.is_nan()));
    }
}
