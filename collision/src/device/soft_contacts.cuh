// Soft contacts on a device: the search of collision_pipeline.cpp with a thread per candidate pair.
// kernel soft_contact_touch 13
// kernel soft_contact_write 21
// kernel soft_contact_clear 7
namespace novaphy {

// The argument words that the search has in common.
struct SoftContactSearch {
  const int32_t* candidates;  // shapes
  int32_t particles;
  float gap;
  const Vec3f* q;
  const float* radius;
  const int32_t* flags;
  const int32_t* world;
  const int32_t* shape_type;
  const int32_t* shape_world;
  const Vec3f* shape_scale;
  const Transformf* shape_transform;
  const float* shape_margin;
  int32_t* tids;
};
template <class T>
T* pointer(uint64_t word) {
  return (T*)word;
}
inline SoftContactSearch soft_contact_search(const uint64_t* w) {
  return {pointer<const int32_t>(w[0]),     (int32_t)w[1],
          ubits_f((int32_t)w[2]),           pointer<const Vec3f>(w[3]),
          pointer<const float>(w[4]),       pointer<const int32_t>(w[5]),
          pointer<const int32_t>(w[6]),     pointer<const int32_t>(w[7]),
          pointer<const int32_t>(w[8]),     pointer<const Vec3f>(w[9]),
          pointer<const Transformf>(w[10]), pointer<const float>(w[11]),
          pointer<int32_t>(w[12])};
}

inline SurfaceDistance<float> surface_distance(int32_t type, const Vec3f& scale, const Vec3f& x) {
  if (type == NOVAPHY_GEO_BOX) return box_distance(x, scale);
  if (type == NOVAPHY_GEO_SPHERE) return sphere_distance(x, scale.x);
  if (type == NOVAPHY_GEO_CAPSULE) return capsule_distance(x, scale.x, scale.y);
  return plane_distance(x, scale.x, scale.y);
}

}  // namespace novaphy

// tids = 1 where the pair touches, else 0. Words: of the search.
NOVAPHY_KERNEL soft_contact_touch(const novaphy_arguments<13> args, const int64_t n,
                                  const device_sink) {
  using namespace novaphy;
  const int64_t pair = NOVAPHY_ROW;
  if (pair >= n) return;
  const SoftContactSearch a = soft_contact_search(args.word);
  const int32_t s = a.candidates[pair / a.particles];
  const int64_t p = pair % a.particles;
  const Transformf to_local = math::inverse(static_shape_pose(a.shape_transform[s]));
  const float reach = a.gap + a.shape_margin[s];
  bool touches = (a.flags[p] & NOVAPHY_PARTICLE_ACTIVE) != 0;
  if (a.world[p] != a.shape_world[s] && a.world[p] >= 0 && a.shape_world[s] >= 0) touches = false;
  if (touches) {
    const Vec3f x = math::transform_point(to_local, a.q[p]);
    touches = surface_distance(a.shape_type[s], a.shape_scale[s], x).distance < reach + a.radius[p];
  }
  a.tids[pair] = touches ? 1 : 0;
}

// Writes the record of every pair that touches into its slot. Words: of the search, then the slots
// before each pair (a scan of tids), particle, shape, body_pos, body_vel, normal, count, and the
// number of slots.
NOVAPHY_KERNEL soft_contact_write(const novaphy_arguments<21> args, const int64_t n,
                                  const device_sink) {
  using namespace novaphy;
  const int64_t pair = NOVAPHY_ROW;
  if (pair >= n) return;
  const uint64_t* const w = args.word;
  const SoftContactSearch a = soft_contact_search(w);
  const int32_t slot = pointer<const int32_t>(w[13])[pair];
  const bool touches = a.tids[pair] != 0;
  if (pair == n - 1) *pointer<int32_t>(w[19]) = slot + (touches ? 1 : 0);
  if (!touches || slot >= (int64_t)w[20]) {
    a.tids[pair] = -1;
    return;
  }
  const int32_t s = a.candidates[pair / a.particles];
  const int64_t p = pair % a.particles;
  const Transformf xform = a.shape_transform[s];
  const Transformf pose = static_shape_pose(xform);
  const Vec3f x = math::transform_point(math::inverse(pose), a.q[p]);
  const StaticContact<float> contact =
      static_contact_record(xform, pose, x, surface_distance(a.shape_type[s], a.shape_scale[s], x));
  a.tids[pair] = slot;
  pointer<int32_t>(w[14])[slot] = (int32_t)p;
  pointer<int32_t>(w[15])[slot] = s;
  pointer<Vec3f>(w[16])[slot] = contact.point;
  // Of the surface in the body's frame: zero, with the signs that rotating it gives.
  pointer<Vec3f>(w[17])[slot] = math::rotate(xform.q, Vec3f{});
  pointer<Vec3f>(w[18])[slot] = contact.normal;
}

// Empties the slots behind the last contact and raises the generation. Words: particle, shape,
// body_pos, body_vel, normal, count, generation.
NOVAPHY_KERNEL soft_contact_clear(const novaphy_arguments<7> args, const int64_t n,
                                  const device_sink) {
  using namespace novaphy;
  const int64_t i = NOVAPHY_ROW;
  if (i >= n) return;
  if (i == 0) ++*pointer<int32_t>(args.word[6]);  // n is one more than the slots
  const int64_t slot = i - 1;
  if (slot < *pointer<const int32_t>(args.word[5])) return;
  pointer<int32_t>(args.word[0])[slot] = -1;
  pointer<int32_t>(args.word[1])[slot] = -1;
  pointer<Vec3f>(args.word[2])[slot] = Vec3f{};
  pointer<Vec3f>(args.word[3])[slot] = Vec3f{};
  pointer<Vec3f>(args.word[4])[slot] = Vec3f{};
}
