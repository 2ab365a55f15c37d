//! The reduce collective: the light images of all leases become their sum. Runs on the compute threads.

use crate::room::Room;
use gatherlight_render::film::LightImage;
use gatherlight_render::film::light_image::Mismatch;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The sum of a job's light images. Addition is exact, so neither the order nor the moment of it matters.
#[derive(Debug)]
pub(crate) struct LightSum {
    /// Images that count and are not added yet, with the memory they take.
    waiting: Mutex<Vec<(LightImage, Room)>>,
    sum: Mutex<LightImage>,
}

impl LightSum {
    /// Nothing has come in yet; `empty` is the job's light image.
    pub(crate) fn new(empty: LightImage) -> Self {
        LightSum { waiting: Mutex::default(), sum: Mutex::new(empty) }
    }
    /// Takes in an image that counts; costs nothing yet. [`LightSum::add_waiting`] is to be called some time after.
    pub(crate) fn put(&self, image: LightImage, room: Room) {
        lock(&self.waiting).push((image, room));
    }
    /// Adds what has come in.
    ///
    /// # Errors
    /// When an image is of another job.
    pub(crate) fn add_waiting(&self) -> Result<(), Mismatch> {
        let mut sum = lock(&self.sum);
        loop {
            let Some((image, _room)) = lock(&self.waiting).pop() else { return Ok(()) };
            sum.add(&image)?;
        }
    }
    /// The sum of all that has come in; the sum kept here is empty afterwards.
    ///
    /// # Errors
    /// As [`LightSum::add_waiting`].
    pub(crate) fn finish(&self, empty: LightImage) -> Result<LightImage, Mismatch> {
        self.add_waiting()?;
        Ok(std::mem::replace(&mut *lock(&self.sum), empty))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic while adding leaves a sum that is used by nobody: it fails the job.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::film::TileGrid;
    use gatherlight_render::math::Rgb;

    #[test]
    fn images_put_in_from_many_threads_are_all_in_the_sum() {
        let empty = LightImage::new(TileGrid { width: 40, height: 20 }, 1, 1.0);
        let (sum, mut expected) = (LightSum::new(empty.clone()), empty.clone());
        let images: Vec<LightImage> = (0..64)
            .map(|i| {
                let mut image = empty.clone();
                image.splat(0, i % 40, i % 20, Rgb::new(i as f32, 0.1, 1e9));
                image.add_rays(u64::from(i));
                expected.add(&image).unwrap();
                image
            })
            .collect();
        std::thread::scope(|scope| {
            for part in images.chunks(16) {
                let sum = &sum;
                scope.spawn(move || {
                    for image in part {
                        sum.put(image.clone(), Room::default());
                        sum.add_waiting().unwrap();
                    }
                });
            }
        });
        sum.put(images[0].clone(), Room::default());
        expected.add(&images[0]).unwrap();
        assert_eq!(sum.finish(empty.clone()), Ok(expected));
        assert_eq!(sum.finish(empty.clone()), Ok(empty.clone()));
        sum.put(LightImage::new(empty.grid(), 2, 1.0), Room::default());
        assert_eq!(sum.add_waiting(), Err(Mismatch));
    }
}
