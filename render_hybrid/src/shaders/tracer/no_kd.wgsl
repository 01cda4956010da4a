// In place of kd.wgsl where no mesh has a kd-tree.
fn kd_hit(i: u32, s: RaySpace, entered: Entered, ray: Ray, any_hit: bool, so_far: Hit) -> Hit {
    return so_far;
}
