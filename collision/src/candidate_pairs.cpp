#include "novaphy/collision/candidate_pairs.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <map>
#include <numeric>

#include "novaphy/core/error.h"

namespace novaphy {

CandidatePairs make_candidate_pairs(const Model& model) {
  const std::vector<int32_t> flags = model.shape_flags.to_host(),
                             shape_world = model.shape_world.to_host(),
                             particle_world = model.particle_world.to_host();
  // The particles of each world, and the particles of all worlds (-1).
  std::map<int32_t, std::vector<int32_t>> of_world;
  for (size_t p = 0; p < particle_world.size(); ++p)
    of_world[std::max(particle_world[p], -1)].push_back(static_cast<int32_t>(p));
  const std::vector<int32_t> everywhere = of_world[-1];
  // The particles that shapes of a world may touch, merged once for each world.
  std::map<int32_t, std::vector<int32_t>> met;
  const auto particles_met = [&](int32_t world) -> const std::vector<int32_t>& {
    const auto [at, is_new] = met.try_emplace(std::max(world, -1));
    std::vector<int32_t>& list = at->second;
    if (!is_new) return list;
    if (world < 0) {
      list.resize(particle_world.size());
      std::iota(list.begin(), list.end(), 0);
    } else {
      const std::vector<int32_t>& own = of_world[world];
      std::merge(own.begin(), own.end(), everywhere.begin(), everywhere.end(),
                 std::back_inserter(list));
    }
    return list;
  };

  CandidatePairs pairs;
  for (size_t s = 0; s < flags.size(); ++s) {
    if (!has_flag(flags[s], ShapeFlags::COLLIDE_PARTICLES)) continue;
    const std::vector<int32_t>& particles = particles_met(shape_world[s]);
    require(pairs.particle.size() + particles.size() <=
                static_cast<size_t>(std::numeric_limits<int32_t>::max()),
            ErrorKind::Value, "CollisionPipeline: expected at most ",
            std::numeric_limits<int32_t>::max(), " candidate pairs, got ",
            pairs.particle.size() + particles.size(), " at shape ", s);
    pairs.particle.insert(pairs.particle.end(), particles.begin(), particles.end());
    pairs.shape.resize(pairs.particle.size(), static_cast<int32_t>(s));
  }
  return pairs;
}

}  // namespace novaphy
