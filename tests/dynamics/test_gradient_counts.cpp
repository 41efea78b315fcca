// The counts of steps for labels of gradients, and the events of contacts between two steps.
#include <gtest/gtest.h>

#include <limits>
#include <string>
#include <vector>

#include "novaphy/dynamics/gradient_info.h"

namespace novaphy {
namespace {

StepNotes events(const std::vector<SeenContact>& before, const std::vector<SeenContact>& now) {
  StepNotes notes;
  note_events(before.data(), static_cast<int32_t>(before.size()), now.data(),
              static_cast<int32_t>(now.size()), notes);
  return notes;
}

TEST(GradientCounts, ContactsAreFoundAgainByPairAndPoint) {
  // Point 3 of the pair (0, 2) persists, and points 1 and 2 change places in the list.
  const std::vector<SeenContact> before = {{0, 1, 0, 1}, {0, 2, 1, 1}, {0, 2, 2, 2}, {0, 2, 3, 2}};
  const std::vector<SeenContact> now = {{0, 2, 2, 2}, {0, 2, 1, 2}, {0, 2, 3, 2}, {1, 2, 0, 1}};
  const StepNotes notes = events(before, now);
  EXPECT_EQ(notes.began, 1);   // (1, 2)
  EXPECT_EQ(notes.ended, 1);   // (0, 1)
  EXPECT_EQ(notes.turned, 1);  // point 1 slips
  EXPECT_EQ(notes.event.first, 0);
  EXPECT_EQ(notes.event.second, 1);
  EXPECT_EQ(notes.event.event, kContactEnded);
}

TEST(GradientCounts, ContactsThatDoNotPushAreNone) {
  EXPECT_FALSE(events({{0, 1, 0, 0}}, {{0, 1, 0, 0}, {0, 2, 0, 0}}).event.there());
  EXPECT_EQ(events({{0, 1, 0, 0}}, {{0, 1, 0, 1}}).began, 1);
  EXPECT_EQ(events({{0, 1, 0, 2}}, {{0, 1, 0, 0}}).ended, 1);
  EXPECT_EQ(events({{0, 1, 0, 2}}, {}).ended, 1);
}

TEST(GradientCounts, TheOrderOfPartsDoesNotMatter) {
  StepNotes a, b;
  a.began = 1;
  a.event = {3, 4, kContactBegan};
  b.turned = 2;
  b.event = {1, 9, kContactTurned};
  b.held = {5, 6, 0};
  StepNotes one, other;
  for (const StepNotes& part : {a, b}) note_all(part, one);
  for (const StepNotes& part : {b, a}) note_all(part, other);
  EXPECT_EQ(one.event.first, 1);
  EXPECT_EQ(other.event.first, 1);
  EXPECT_EQ(one.held.second, other.held.second);
  EXPECT_EQ(one.began + one.turned, 3);
}

TEST(GradientCounts, TheLabelIsThatOfTheWorstStep) {
  GradientCounts counts;
  StepNotes notes;
  note_step(notes, counts);
  notes.residual = 0.9f * kSurrogateResidual;
  note_step(notes, counts);
  EXPECT_EQ(gradient_info(counts).label, "exact of the code");
  EXPECT_EQ(gradient_info(counts, true).label, "implicit");
  EXPECT_NE(gradient_info(counts).reason.find("no contact changed"), std::string::npos);
  notes.held = {2, ContactPair::kParticle + 7, 0};
  note_step(notes, counts);
  GradientInfo info = gradient_info(counts);
  EXPECT_EQ(info.label, "frozen");
  EXPECT_NE(info.reason.find("step 2, particle 7 and shape 2"), std::string::npos) << info.reason;
  notes.event = {0, 1, kContactBegan};
  notes.began = 1;
  notes.residual = 1.1f * kSurrogateResidual;
  note_step(notes, counts);
  info = gradient_info(counts);
  EXPECT_EQ(info.label, "surrogate");
  EXPECT_EQ(info.steps, 4);
  EXPECT_EQ(info.exact_steps, 2);
  EXPECT_EQ(info.frozen_steps, 1);
  EXPECT_EQ(info.surrogate_steps, 1);
  EXPECT_EQ(info.events, 1);
  EXPECT_NE(info.reason.find("step 3: that of shapes 0 and 1 begins"), std::string::npos)
      << info.reason;
}

TEST(GradientCounts, AResidualThatIsNoNumberIsASurrogate) {
  GradientCounts counts;
  StepNotes notes;
  notes.residual = std::numeric_limits<float>::quiet_NaN();
  note_step(notes, counts);
  EXPECT_EQ(counts.surrogate, 1);
}

}  // namespace
}  // namespace novaphy
