/* A program with an old MSVCP140.dll in memory, as Blender 4.2 to 5.0 for Windows are, that computes with Dr.Jit.

   old_blender.exe FOLDER: of the packages. It prints a line for each step that is done. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>
#include <psapi.h>

enum { LLVM = 2, REDUCE_ADD = 1, TYPE_UINT32 = 8 }; /* JitBackend, ReduceOp and VarType of drjit-core/jit.h */

static HMODULE load(const char *folder, const char *package, const char *name) {
    char path[4096];
    snprintf(path, sizeof path, "%s\\%s\\%s", folder, package, name);
    /* as Python loads its modules, and ctypes a library */
    HMODULE module = LoadLibraryExA(path, NULL, LOAD_LIBRARY_SEARCH_DLL_LOAD_DIR | LOAD_LIBRARY_SEARCH_DEFAULT_DIRS);
    if (!module) {
        printf("%s cannot be loaded: error %lu\n", name, GetLastError());
        exit(1);
    }
    printf("%s is loaded\n", name);
    fflush(stdout);
    return module;
}

static void *function(HMODULE module, const char *name) {
    void *found = (void *) GetProcAddress(module, name);
    if (!found) {
        printf("%s is missing\n", name);
        exit(1);
    }
    return found;
}

static volatile LONG counted;

static void count(uint32_t index, void *payload) {
    (void) payload;
    InterlockedAdd(&counted, index);
}

static void cpp_libraries(void) {
    HMODULE modules[1024];
    DWORD size;
    char path[4096];
    EnumProcessModules(GetCurrentProcess(), modules, sizeof modules, &size);
    for (DWORD i = 0; i < size / sizeof *modules; i++)
        if (GetProcAddress(modules[i], "_Mtx_lock")) {
            GetModuleFileNameA(modules[i], path, sizeof path);
            printf("C++ library: %s\n", path);
        }
}

int main(int argc, char **argv) {
    char llvm_path[4096];
    if (argc != 2 || !LoadLibraryA("msvcp140.dll")) {
        printf("needs a folder, and msvcp140.dll beside the program\n");
        return 1;
    }
    cpp_libraries();

    /* HoloPath asks LLVM for its version before Dr.Jit is imported */
    void (*version)(unsigned *, unsigned *, unsigned *) = function(load(argv[1], "holopath_llvm", "LLVM-C.dll"), "LLVMGetVersion");
    unsigned major, minor, patch;
    version(&major, &minor, &patch);
    printf("LLVM %u.%u.%u\n", major, minor, patch);
    snprintf(llvm_path, sizeof llvm_path, "%s\\holopath_llvm\\LLVM-C.dll", argv[1]);
    _putenv_s("DRJIT_LIBLLVM_PATH", llvm_path);
    SetEnvironmentVariableA("DRJIT_LIBLLVM_PATH", llvm_path);

    HMODULE threads = load(argv[1], "drjit", "nanothread.dll"), core = load(argv[1], "drjit", "drjit-core.dll");
    load(argv[1], "drjit", "drjit-extra.dll");
    void *(*pool_create)(uint32_t, int) = function(threads, "pool_create");
    void *(*task_submit_dep)(void *, const void *, uint32_t, uint32_t, void (*)(uint32_t, void *), void *, uint32_t,
                             void (*)(void *), int, int) = function(threads, "task_submit_dep");
    void (*task_wait)(void *) = function(threads, "task_wait_and_release");
    task_wait(task_submit_dep(pool_create(2, 1), NULL, 0, 1000, count, NULL, 0, NULL, 1, 0));
    printf("nanothread's sum %ld\n", (long) counted);
    fflush(stdout);

    void (*init)(uint32_t) = function(core, "?jit_init@@YAXI@Z");
    uint32_t (*counter)(uint32_t, size_t) = function(core, "?jit_var_counter@@YAIW4JitBackend@@_K@Z");
    uint32_t (*literal)(uint32_t, uint32_t) = function(core, "?jit_var_u32@@YAIW4JitBackend@@I@Z");
    uint32_t (*add)(uint32_t, uint32_t) = function(core, "?jit_var_add@@YAIII@Z");
    uint32_t (*reduce)(uint32_t, uint32_t, uint32_t, uint32_t) =
        function(core, "?jit_var_reduce@@YAIW4JitBackend@@W4VarType@@W4ReduceOp@@I@Z");
    void (*read)(uint32_t, size_t, void *) = function(core, "?jit_var_read@@YAXI_KPEAX@Z");
    uint32_t sum = 0;
    init(1u << LLVM);
    read(reduce(LLVM, TYPE_UINT32, REDUCE_ADD, add(counter(LLVM, 1000), literal(LLVM, 1))), 0, &sum);
    printf("Dr.Jit's sum %u\n", sum);
    fflush(stdout);

    load(argv[1], "mitsuba", "mitsuba.dll");
    load(argv[1], "mitsuba\\plugins", "path.dll");
    cpp_libraries();
    printf("done\n");
    fflush(stdout);
    TerminateProcess(GetCurrentProcess(), 0); /* with the threads of both pools */
}
