// Registers the importers and processing steps of assimp that load_mesh needs. This file replaces
// assimp's Common/ImporterRegistry.cpp and Common/PostStepRegistry.cpp, which register all
// importers and steps.
#include <vector>

#include "AssetLib/Collada/ColladaLoader.h"
#include "AssetLib/Obj/ObjFileImporter.h"
#include "AssetLib/Ply/PlyLoader.h"
#include "AssetLib/STL/STLLoader.h"
#include "PostProcessing/TriangulateProcess.h"

namespace Assimp {

void GetImporterInstanceList(std::vector<BaseImporter*>& out) {
  out = {new ColladaLoader, new ObjFileImporter, new PLYImporter, new STLImporter};
}

void DeleteImporterInstanceList(std::vector<BaseImporter*>& importers) {
  for (const BaseImporter* importer : importers) delete importer;
}

// assimp validates a scene before it runs the steps of this list.
void GetPostProcessingStepInstanceList(std::vector<BaseProcess*>& out) {
  out = {new TriangulateProcess};
}

}  // namespace Assimp
