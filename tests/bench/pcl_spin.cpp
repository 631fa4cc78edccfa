// PCL's spin images about a fixed vertical axis, timed: the peer of tests/bench/scan.py.
//
//     pcl_spin points.f32 indices.i32 radius_m
//
// points.f32 holds float32 x, y, z of every point, indices.i32 the int32 numbers of the points
// that are origins. Prints the CPU seconds of the estimation alone (the search tree is built
// before) and the number of spin images that came out finite.
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <iterator>
#include <vector>

#include <pcl/features/impl/spin_image.hpp>
#include <pcl/features/spin_image.h>
#include <pcl/point_types.h>
#include <pcl/search/impl/search.hpp>
#include <pcl/search/kdtree.h>

constexpr int WIDTH = 25;
using Image = pcl::Histogram<(WIDTH + 1) * (2 * WIDTH + 1)>;

template <typename T>
std::vector<T> read(const char* path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  std::vector<T> values(static_cast<std::size_t>(file.tellg()) / sizeof(T));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(values.data()), values.size() * sizeof(T));
  return values;
}

int main(int argc, char** argv) {
  if (argc != 4) {
    std::cerr << "usage: pcl_spin points.f32 indices.i32 radius_m\n";
    return 2;
  }
  const auto xyz = read<float>(argv[1]);
  const auto numbers = read<std::int32_t>(argv[2]);
  const pcl::PointCloud<pcl::PointXYZ>::Ptr cloud(new pcl::PointCloud<pcl::PointXYZ>);
  const pcl::PointCloud<pcl::Normal>::Ptr up(new pcl::PointCloud<pcl::Normal>);
  for (std::size_t i = 0; i < xyz.size(); i += 3) {
    cloud->push_back(pcl::PointXYZ(xyz[i], xyz[i + 1], xyz[i + 2]));
    up->push_back(pcl::Normal(0.f, 0.f, 1.f));
  }
  const pcl::IndicesPtr origins(new pcl::Indices(numbers.begin(), numbers.end()));
  const pcl::search::KdTree<pcl::PointXYZ>::Ptr tree(new pcl::search::KdTree<pcl::PointXYZ>);
  tree->setInputCloud(cloud);

  pcl::SpinImageEstimation<pcl::PointXYZ, pcl::Normal, Image> estimation(WIDTH, 0.0, 0);
  estimation.setInputCloud(cloud);
  estimation.setIndices(origins);
  estimation.setInputNormals(up);
  estimation.setSearchMethod(tree);
  estimation.setRadiusSearch(std::atof(argv[3]));
  estimation.setRotationAxis(pcl::Normal(0.f, 0.f, 1.f));

  pcl::PointCloud<Image> images;
  const std::clock_t start = std::clock();
  estimation.compute(images);
  const double seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
  std::size_t finite = 0;
  for (const auto& image : images) finite += std::isfinite(image.histogram[0]);
  std::cout << seconds << " " << finite << "\n";
}
