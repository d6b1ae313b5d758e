/* Stand-ins for ONNX Runtime's library: VERSION is what it calls itself; without VERSION it is some other library. It has no interface. */
#ifdef VERSION
typedef struct {
  const void *(*get_api)(unsigned version);
  const char *(*get_version)(void);
} Base;
static const void *get_api(unsigned version) { return (void)version, (const void *)0; }
static const char *get_version(void) { return VERSION; }
static const Base base = {get_api, get_version};
const Base *OrtGetApiBase(void) { return &base; }
#else
int something_else(void) { return 1; }
#endif
