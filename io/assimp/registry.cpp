// What assimp has of importers and processing steps: those of load_mesh. This takes the place of its
// Common/ImporterRegistry.cpp and Common/PostStepRegistry.cpp, which list all that it knows.
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

void GetPostProcessingStepInstanceList(std::vector<BaseProcess*>& out) {
  out = {new TriangulateProcess};
}

}  // namespace Assimp
