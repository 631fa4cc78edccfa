// One instance a round with PCL: spin images, prerejective RANSAC [Buch 2013] and ICP, as in PCL's
// tutorial "Robust pose estimation of rigid objects", whose numbers these are. Driven by
// peers_matchers.py.
//
//     pcl_match model.f32 scene.f32 voxel_m
//
// Files hold float32 x, y, z, nx, ny, nz of every point. Of every round, standard input brings one
// byte a scene point (0: erased), standard output takes T_scene_model: 16 float32, row by row, NaN
// where there is none.
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <iterator>
#include <vector>

#include <pcl/features/impl/spin_image.hpp>
#include <pcl/features/spin_image.h>
#include <pcl/kdtree/impl/kdtree_flann.hpp>
#include <pcl/point_types.h>
#include <pcl/registration/icp.h>
#include <pcl/registration/sample_consensus_prerejective.h>

using Point = pcl::PointNormal;
using Cloud = pcl::PointCloud<Point>;
using Image = pcl::Histogram<153>;  // 9 x 17 bins: PCL's own width of 8
using Images = pcl::PointCloud<Image>;

Cloud::Ptr read(const char* path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  std::vector<float> v(static_cast<std::size_t>(file.tellg()) / sizeof(float));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(v.data()), v.size() * sizeof(float));
  const Cloud::Ptr cloud(new Cloud);
  for (std::size_t i = 0; i < v.size(); i += 6) {
    Point p;
    p.getVector3fMap() = Eigen::Vector3f(v[i], v[i + 1], v[i + 2]);
    p.getNormalVector3fMap() = Eigen::Vector3f(v[i + 3], v[i + 4], v[i + 5]);
    cloud->push_back(p);
  }
  return cloud;
}

Images::Ptr describe(const Cloud::Ptr& cloud, double radius) {
  pcl::SpinImageEstimation<Point, Point, Image> estimation;
  estimation.setInputCloud(cloud);
  estimation.setInputNormals(cloud);
  estimation.setRadiusSearch(radius);
  const Images::Ptr images(new Images);
  estimation.compute(*images);
  for (auto& image : *images)
    for (auto& bin : image.histogram)
      if (!std::isfinite(bin)) bin = 0.f;
  return images;
}

int main(int argc, char** argv) {
  if (argc != 4) {
    std::cerr << "usage: pcl_match model.f32 scene.f32 voxel_m\n";
    return 2;
  }
  const double voxel = std::atof(argv[3]);
  const auto model = read(argv[1]), scene = read(argv[2]);
  const auto model_images = describe(model, 5 * voxel), images = describe(scene, 5 * voxel);
  std::vector<char> left(scene->size());
  while (std::cin.read(left.data(), left.size())) {
    const Cloud::Ptr target(new Cloud);
    const Images::Ptr target_images(new Images);
    for (std::size_t i = 0; i < left.size(); ++i)
      if (left[i]) target->push_back((*scene)[i]), target_images->push_back((*images)[i]);
    pcl::SampleConsensusPrerejective<Point, Point, Image> align;
    align.setInputSource(model);
    align.setSourceFeatures(model_images);
    align.setInputTarget(target);
    align.setTargetFeatures(target_images);
    align.setMaximumIterations(50000);
    align.setNumberOfSamples(3);
    align.setCorrespondenceRandomness(5);
    align.setSimilarityThreshold(0.95f);
    align.setMaxCorrespondenceDistance(2.5 * voxel);
    align.setInlierFraction(0.25f);
    Cloud placed;
    align.align(placed);
    Eigen::Matrix<float, 4, 4, Eigen::RowMajor> T;
    T.setConstant(NAN);
    if (align.hasConverged()) {
      pcl::IterativeClosestPoint<Point, Point> icp;
      icp.setInputSource(model);
      icp.setInputTarget(target);
      icp.setMaxCorrespondenceDistance(voxel);
      icp.setMaximumIterations(50);
      icp.align(placed, align.getFinalTransformation());
      T = icp.getFinalTransformation();
    }
    std::cout.write(reinterpret_cast<const char*>(T.data()), sizeof(float) * 16).flush();
  }
}
