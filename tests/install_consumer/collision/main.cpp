// Finds the contacts of a particle with a wall and the ground. No solver, no gradients: one library.
#include <iostream>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"

int main() {
  novaphy::ModelBuilder builder;
  builder.add_particle({0.0f, 1.7f, 0.05f}, {0.0f, 0.0f, 0.0f}, 1.0f, 0.1f);
  novaphy::Transformf wall = novaphy::Transformf::identity();
  wall.p = {0.0f, 2.0f, 1.0f};
  builder.add_shape_box(-1, {.xform = wall, .hx = 1.0f, .hy = 0.25f, .hz = 1.0f});
  builder.add_ground_plane();
  const auto model = builder.finalize();

  novaphy::CollisionPipeline pipeline(model);
  novaphy::Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);

  for (const novaphy::SoftContact& contact : contacts.soft_contacts())
    std::cout << "particle " << contact.particle << " touches "
              << model->shape_label[static_cast<size_t>(contact.shape)] << ", normal (" << contact.normal.x
              << ", " << contact.normal.y << ", " << contact.normal.z << ")\n";
  return contacts.active_soft_contact_count() == 2 ? 0 : 1;
}
